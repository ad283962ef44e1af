r"""The base class of all models."""

from typing import Any, NoReturn, Self

from torch import Tensor
from torch.nn import Module
from torch_geometric.nn.inits import reset
from torch_geometric.typing import OptTensor

from torch_geometric_tactile.data._fingerprint import constructor_arguments
from torch_geometric_tactile.nn.models._taxels import portable_layout


def _raise_for_hub_method(*args: Any, **kwargs: Any) -> NoReturn:
    # To be deleted in version 0.4.0, together with the names in `_removed.py`.
    raise AttributeError(
        "'save_pretrained', 'from_pretrained' and 'push_to_hub' of models were removed in version "
        "0.3.0: to save the model with its layout and scaling, use Predictor.save or "
        "Predictor.push_to_hub"
    )


class BaseModel(Module):
    r"""The base class of all models. Its :meth:`forward` defines the inputs of all models and their
    order.

    A subclass defines :meth:`_logits` with the inputs that it uses, or :meth:`forward` if it has
    further inputs. The attribute :attr:`init_arguments` holds the arguments of the constructor in
    order. The file of a :class:`~torch_geometric_tactile.predictor.Predictor` stores these
    arguments so that the model can be recreated.
    """

    num_joints: int = 0
    init_arguments: dict[str, Any]

    from_pretrained = save_pretrained = push_to_hub = staticmethod(_raise_for_hub_method)

    def __new__(cls, *args: Any, **kwargs: Any) -> Self:
        r"""Creates the model and stores the arguments of its constructor."""
        self = object.__new__(cls)
        arguments = constructor_arguments(cls, args, kwargs)
        if "layout" in arguments:
            arguments["layout"] = portable_layout(arguments["layout"])
        self.init_arguments = arguments
        return self

    @property
    def modalities(self) -> tuple[str, ...]:
        r"""Names of the attributes of a batch that are passed to :meth:`forward` by keyword, in
        addition to :obj:`x` and :obj:`edge_index`.
        """
        return ("joint",) if self.num_joints else ()

    def reset_parameters(self) -> None:
        r"""Resets all learnable parameters."""
        for child in self.children():
            reset(child)

    def forward(
        self,
        x: Tensor,
        edge_index: OptTensor = None,
        edge_attr: OptTensor = None,
        joint: OptTensor = None,
        absolute: OptTensor = None,
        pos: OptTensor = None,
    ) -> Tensor:
        r"""Returns the logits :math:`(B, C)`.

        All models take the same arguments in the same order. A model uses :obj:`x`,
        :obj:`edge_index` if it has a graph, and the inputs in its :attr:`modalities`. It ignores
        all other arguments.

        Args:
            x (torch.Tensor): Readings :math:`(N, F)`, :math:`(B, N, F)` or, for a PyG batch,
                :math:`(B \cdot N, F)`.
            edge_index (torch.Tensor, optional): Edges :math:`(2, |\mathcal{E}|)`. Models without a
                graph do not need edges.
            edge_attr (torch.Tensor, optional): Edge features :math:`(|\mathcal{E}|, D)`,
                :math:`(B, |\mathcal{E}|, D)` or the edge features of a PyG batch.
            joint (torch.Tensor, optional): Joint angles in radians :math:`(B, J)`.
            absolute (torch.Tensor, optional): Positions and their distance from the origin, in
                metres or scaled, with the leading shape of :obj:`x`, or :math:`(N, 4)` for all
                samples.
            pos (torch.Tensor, optional): Positions in metres or scaled, with the leading shape of
                :obj:`x`, or :math:`(N, 3)` for all samples.
        """
        return self._logits(
            x, edge_index=edge_index, edge_attr=edge_attr, joint=joint, absolute=absolute, pos=pos
        )

    def _logits(self, x: Tensor, **inputs: Any) -> Tensor:
        raise NotImplementedError

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.extra_repr()})"
