"""The Gymnasium layer: tasks, the runner that steps them, and the environments."""
