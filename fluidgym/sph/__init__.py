"""Warp device code, one file for each idea: the terms, and the machinery that runs them."""
