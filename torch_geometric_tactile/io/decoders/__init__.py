r"""Decoders of the bytes of serial sensors."""
