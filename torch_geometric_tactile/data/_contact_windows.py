r"""Detection of windows without contact."""

import numpy as np

from torch_geometric_tactile.data.contact_rule import ContactRule


class ContactWindow:
    r"""Decides for a stream of frames whether the window that ends with the newest frame lacks
    contact: none of its frames has contact, and at least one frame has readings.

    Args:
        length (int): Number of frames in a window.

    Examples:
        >>> rule = ContactRule(threshold=1.0, rest=np.zeros((4, 1)))
        >>> window, touch = ContactWindow(2), np.full((4, 1), 5.0)
        >>> [window.push(rule, frame) for frame in (touch, 0 * touch, 0 * touch)]
        [False, False, True]
    """

    def __init__(self, length: int) -> None:
        # Not reset after a gap: callers only ask once the window is full of new frames again.
        self.length = length
        self._num_frames = 0
        self._last_contact = self._last_free = -1  # numbers of frames, counted from 1

    def push(self, rule: ContactRule, tactile: np.ndarray) -> bool:
        r"""Adds the next frame and returns whether the window lacks contact.

        Args:
            rule (ContactRule): The rule that decides whether a frame has contact.
            tactile (numpy.ndarray): Readings :math:`(N, C)`.
        """
        self._num_frames += 1
        if rule.lacks_contact(tactile):
            self._last_free = self._num_frames
        elif rule.is_contact(tactile):
            self._last_contact = self._num_frames
        start = max(self._num_frames - self.length, 0)
        return self._last_contact <= start and self._last_free > start


def windows_lacking_contact(
    rule: ContactRule, tactile: np.ndarray, start: np.ndarray, stop: np.ndarray
) -> np.ndarray:
    r"""Returns which windows of a recording lack contact, in the sense of :class:`ContactWindow`.

    Args:
        rule (ContactRule): The rule that decides whether a frame has contact.
        tactile (numpy.ndarray): The frames from which the windows are cut :math:`(T, N, C)`.
        start (numpy.ndarray): The first frame of each window :math:`(W,)`.
        stop (numpy.ndarray): The first frame after each window :math:`(W,)`.

    Shapes:
        - **output:** booleans :math:`(W,)`

    Examples:
        >>> rule = ContactRule(threshold=1.0, rest=np.zeros((4, 1)))
        >>> frames = np.zeros((3, 4, 1))
        >>> frames[0] = 5.0
        >>> windows_lacking_contact(rule, frames, np.array([0, 1]), np.array([2, 3]))
        array([False,  True])
    """
    # With cumulative counts, the count within any window is the difference of two numbers.
    flags = np.stack([rule.is_contact(tactile), rule.lacks_contact(tactile)]).astype(np.int64)
    count = np.concatenate([np.zeros((2, 1), np.int64), np.cumsum(flags, axis=1)], axis=1)
    num_contacts, num_free = count[:, stop] - count[:, start]
    return np.asarray((num_contacts == 0) & (num_free > 0))
