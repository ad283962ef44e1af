r"""Layout, fitted transforms and model in one file."""
