r"""Callbacks of a live session."""

from typing import TYPE_CHECKING

from torch_geometric_tactile.data.live_frame import LiveFrame

if TYPE_CHECKING:
    from torch_geometric_tactile.live.health import Health
    from torch_geometric_tactile.live.judge import Judgement
    from torch_geometric_tactile.live.session import LiveSession


class Callback:
    r"""Base class of the callbacks of a :class:`~torch_geometric_tactile.live.LiveSession`, for
    example to close a gripper before an object slips. Each method does nothing unless overridden.

    The thread that runs the model calls all methods except :meth:`on_health`, one after another. A
    slow method makes the session skip frames, but never the recorder. An exception ends the
    session, and :meth:`LiveSession.run` raises it.

    Examples:
        >>> class Gripper(Callback):
        ...     def on_judgement(self, session, judgement):
        ...         if judgement.label == "slip":
        ...             print("close the hand")
    """

    def on_start(self, session: "LiveSession") -> None:
        r"""Called once the source is open.

        Args:
            session (LiveSession): The session.
        """

    def on_frame(self, session: "LiveSession", frame: LiveFrame) -> None:
        r"""Called with each frame that the session does not skip, before the model uses it.

        Args:
            session (LiveSession): The session.
            frame (LiveFrame): The frame.
        """

    def on_judgement(self, session: "LiveSession", judgement: "Judgement") -> None:
        r"""Called with the prediction of the model for a frame.

        Args:
            session (LiveSession): The session.
            judgement (Judgement): Probabilities, label and latency.
        """

    def on_health(self, session: "LiveSession", health: "Health") -> None:
        r"""Called about twice a second, by the thread that runs the session.

        Args:
            session (LiveSession): The session.
            health (Health): The state of the stream.
        """

    def on_end(self, session: "LiveSession") -> None:
        r"""Called once at the end, even after an error.

        Args:
            session (LiveSession): The session.
        """
