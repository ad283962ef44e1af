r"""How much the files and messages of others may ask for, whatever sizes they claim."""

#: How many times the bytes of a file its content may take: a hand that rests for long is packed to
#: a hundredth. Below the sizes of bytes that follow, any file is read.
EXPANSION = 200
HDF5_EXPANSION = 100  # chunks are packed one by one
ARRAY_BYTES = 2**30  # of recordings and data sets; ten minutes of a hand take a quarter
PRESSURE_MAT_BYTES = 2**24  # of a text file of PressureMat; those published have below 2**21
IDX_BYTES = 2**27  # all images of MNIST take a third
MAT_TEXT_BYTES = 2**20  # of a cell array of texts; ten thousand names take less
MAT_BYTES = 2**26  # which are taken on trust of what is packed, before its checksum

PICKLE_STEPS = 5_000_000  # half an hour of a hand at 100 frames a second takes as many

RECORD_BYTES = 2**27  # of a record of MCAP, and of what a chunk of them may become
FRAME_BYTES = 2**26  # of one frame in MCAP
PNG_BYTES = 2**22  # of a file, with whatever a camera or program writes beside a small image
TEXT_BYTES = 2**16  # of one text in HDF5
JSON_BYTES = 2**27  # of a file; a layout of half a million taxels has less
CONFIG_BYTES = 2**21  # of a configuration in YAML, whose reader is slow
LEROBOT_TASKS = 1_000_000  # equal texts are held once, but each number takes memory

MODEL_BYTES = 2**28  # that building a model may ask for beside its own
MODEL_TENSORS = 5_000  # likewise, so that building many small layers ends soon

SENSOR_MESSAGE_BYTES = 2**24  # of a message of a sensor's server
VIEWER_MESSAGE_BYTES = 2**10  # that a viewer may send at once: it presses buttons only


def is_absurd(size: int, file_size: int, most: int, expansion: int = EXPANSION) -> bool:
    r"""Tells whether a file would take more than :obj:`most` bytes of memory, and more than so many
    times its own, as one does that is made to fill the memory.

    Examples:
        >>> is_absurd(2**31, file_size=2**20, most=ARRAY_BYTES)
        True
        >>> is_absurd(2**31, file_size=2**30, most=ARRAY_BYTES)
        False
    """
    return size > max(most, expansion * file_size)
