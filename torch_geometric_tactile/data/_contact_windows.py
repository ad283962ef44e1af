r"""Windows of frames without contact."""

import numpy as np

from torch_geometric_tactile.data.contact_rule import ContactRule


class ContactWindow:
    r"""Tells of frames that come one by one whether the window that ends with the newest one lacks
    contact: no frame of it has contact, and one has readings.

    Args:
        length (int): Number of frames of a window.

    Examples:
        >>> rule = ContactRule(threshold=1.0, rest=np.zeros((4, 1)))
        >>> window, touch = ContactWindow(2), np.full((4, 1), 5.0)
        >>> [window.push(rule, frame) for frame in (touch, 0 * touch, 0 * touch)]
        [False, False, True]
    """

    def __init__(self, length: int) -> None:
        # No reset after a gap: there is no answer before the window is full of new frames.
        self.length = length
        self._number = 0
        self._last_contact = self._last_free = -1

    def push(self, rule: ContactRule, tactile: np.ndarray) -> bool:
        r"""Takes the next frame, and returns whether the window lacks contact.

        Args:
            rule (ContactRule): The rule.
            tactile (numpy.ndarray): Readings :math:`(N, C)`.
        """
        self._number += 1
        if rule.lacks_contact(tactile):
            self._last_free = self._number
        elif rule.is_contact(tactile):
            self._last_contact = self._number
        start = max(self._number - self.length, 0)
        return self._last_contact <= start and self._last_free > start


def windows_lacking_contact(
    rule: ContactRule, tactile: np.ndarray, start: np.ndarray, stop: np.ndarray
) -> np.ndarray:
    r"""Returns which windows of a recording lack contact, as :class:`ContactWindow`.

    Args:
        rule (ContactRule): The rule.
        tactile (numpy.ndarray): The frames that windows are cut from :math:`(T, N, C)`.
        start (numpy.ndarray): The first frame of each window :math:`(W,)`.
        stop (numpy.ndarray): The frame behind the last of each window :math:`(W,)`.

    Shapes:
        - **output:** :math:`(W,)`

    Examples:
        >>> rule = ContactRule(threshold=1.0, rest=np.zeros((4, 1)))
        >>> frames = np.zeros((3, 4, 1))
        >>> frames[0] = 5.0
        >>> windows_lacking_contact(rule, frames, np.array([0, 1]), np.array([2, 3]))
        array([False,  True])
    """
    counts = np.stack([rule.is_contact(tactile), rule.lacks_contact(tactile)]).astype(np.int64)
    total = np.concatenate([np.zeros((2, 1), np.int64), np.cumsum(counts, axis=1)], axis=1)
    num_contacts, num_free = total[:, stop] - total[:, start]
    return np.asarray((num_contacts == 0) & (num_free > 0))
