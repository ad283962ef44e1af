r"""One YAML file per experiment; ``tactile fit --config NAME`` finds them by name."""
