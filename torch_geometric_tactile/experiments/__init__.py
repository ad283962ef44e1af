r"""Experiments as values, and the functions that run them. Needs the extra ``train``."""
