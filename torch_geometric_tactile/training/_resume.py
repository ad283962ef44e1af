r"""Trainings that go on from a checkpoint as if they had never stopped."""

from typing import Any

import lightning as L
import torch

from torch_geometric_tactile.loader._random_states import RandomStates

_ENTRY = "random_states"


class ResumableModule(L.LightningModule):
    r"""A module whose checkpoints keep the states of the sources of random numbers, so that a
    training that is resumed draws what it would have drawn.

    Resumed from a checkpoint of the end of an epoch, or of a step
    (:obj:`ModelCheckpoint(every_n_train_steps=)`), weights are those of the training that was never
    stopped, bit by bit on a CPU. For a step this asks for loaders that can go on in the middle of
    an epoch, such as those of :class:`~torch_geometric_tactile.training.TactileDataModule`; with
    workers, for :class:`~torch_geometric_tactile.loader.StaticLoader` with :obj:`keyed=True`.
    """

    _random_states: dict[str, Any] | None = None

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        r"""Puts the random states into the checkpoint."""
        states = RandomStates.now().to_dict()
        if torch.cuda.is_available() and torch.cuda.is_initialized():
            states["cuda"] = torch.cuda.get_rng_state_all()
        checkpoint[_ENTRY] = states

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        r"""Takes the random states from the checkpoint, if it is one to go on from.

        Raises:
            ValueError: If they were changed.
        """
        self._random_states = None
        if self._trainer is None or self.trainer.state.fn != "fit":
            return
        self._random_states = checkpoint.get(_ENTRY)
        if self._random_states is not None:
            try:
                RandomStates.from_dict(self._random_states)
            except ValueError as error:
                raise ValueError(
                    f"'{self.trainer.ckpt_path}' cannot be resumed: {error}; train again"
                ) from error
        _mark_ended(checkpoint.get("loops", {}).get("fit_loop", {}))
        if self.trainer.strategy.restore_checkpoint_after_setup:  # then training starts next
            self._restore_random_states()

    def on_fit_start(self) -> None:
        r"""Restores the random states: models and optimizers are built, and no batch is drawn."""
        self._restore_random_states()

    def _restore_random_states(self) -> None:
        states, self._random_states = self._random_states, None
        if states is None:
            return
        RandomStates.from_dict(states).restore()
        cuda = states.get("cuda", ())
        if torch.cuda.is_available() and len(cuda) == torch.cuda.device_count():
            torch.cuda.set_rng_state_all([state.cpu() for state in cuda])


def _mark_ended(fit_loop: dict[str, Any]) -> None:
    # With `limit_train_batches` a loader cannot tell by itself that its epoch has ended.
    if fit_loop.get("epoch_loop.batch_progress", {}).get("is_last_batch"):
        for state in fit_loop.get("state_dict", {}).get("combined_loader", ()):
            state["ended"] = True
