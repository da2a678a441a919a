"""A page in the browser with the fluid live in it: `python -m fluidgym view`."""
