r"""The BioTac SP fingertips of the stability set."""

FINGERS = ("ff", "mf", "th")


NUM_ELECTRODES = 24
