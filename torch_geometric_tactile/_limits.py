r"""Limits on the memory that untrusted files and messages may request."""

#: Maximum ratio of the size of the content to the size of its file. A long recording without
#: contact is compressed to a hundredth. Content that is smaller than the limits below is always
#: read.
EXPANSION = 200
HDF5_EXPANSION = 100  # chunks are compressed separately
ARRAY_BYTES = 2**30  # of recordings and data sets; ten minutes of a hand take a quarter of it
PRESSURE_MAT_BYTES = 2**24  # of a text file of PressureMat; published ones have less than 2**21
IDX_BYTES = 2**27  # all images of MNIST take a third of it
MAT_TEXT_BYTES = 2**20  # of a cell array of texts; ten thousand names take less
MAT_BYTES = 2**26  # of compressed content that is read before its checksum is known

PICKLE_STEPS = 5_000_000  # half an hour of a hand at 100 frames per second takes this number

RECORD_BYTES = 2**27  # of a record of MCAP, and of the content of a chunk
FRAME_BYTES = 2**26  # of one frame in MCAP
PNG_BYTES = 2**22  # of a file: a small image, and metadata that a camera or program adds
TEXT_BYTES = 2**16  # of one text in HDF5
JSON_BYTES = 2**27  # of a file; a layout of half a million taxels takes less
CONFIG_BYTES = 2**21  # of a YAML configuration, whose reader is slow
LEROBOT_TASKS = 1_000_000  # equal texts are stored once, but each index takes memory

MODEL_BYTES = 2**28  # that building a model may allocate beside its parameters
MODEL_TENSORS = 5_000  # of a model, which limits the time to build many small layers

SENSOR_MESSAGE_BYTES = 2**24  # of a message of a sensor's server
VIEWER_MESSAGE_BYTES = 2**10  # of a message of a viewer, which only sends buttons


def is_absurd(size: int, file_size: int, limit: int, expansion: int = EXPANSION) -> bool:
    r"""Returns whether a file would need more than :obj:`limit` bytes of memory and more than
    :obj:`expansion` times its size. This is the case for files that are made to exhaust the memory.

    Examples:
        >>> is_absurd(2**31, file_size=2**20, limit=ARRAY_BYTES)
        True
        >>> is_absurd(2**31, file_size=2**30, limit=ARRAY_BYTES)
        False
    """
    return size > max(limit, expansion * file_size)
