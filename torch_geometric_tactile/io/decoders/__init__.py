r"""Decoders of what serial sensors send."""
