r"""When a difference is beyond the noise."""

LEAST_PAIRS = 3


RULE = (
    "A difference is beyond the noise if it is larger than both standard errors times Student's t "
    "(two-sided, 5 %); the error over the splits is corrected for training sets that overlap "
    f"(Nadeau and Bengio, 2003). There is no verdict on fewer than {LEAST_PAIRS} splits."
)
