r"""Experiments as values, and what runs them. Needs the extra ``train``."""
