r"""Message passing of PyG whose uncompiled form stays at hand."""

from collections.abc import Iterable
from typing import Any

from torch.nn import Module
from torch_geometric.nn import MessagePassing


class OwnPropagate:
    r"""Gives each class of layers a compiled :meth:`propagate` of its own, and keeps the uncompiled
    one, which can be explained: a base class before :class:`~torch_geometric.nn.MessagePassing`.

    PyG compiles :meth:`propagate` into the class of the first layer that is made, and its
    subclasses inherit that form. If that layer is a bare :obj:`MessagePassing()`, all layers of all
    packages that are made afterwards lose the form that an explainer needs. The private names are
    tested on the oldest and the newest release of PyG.
    """

    def _set_jittable_templates(self, raise_on_error: bool = False) -> None:
        cls: Any = type(self)
        is_custom = _has_custom_propagate(cls)
        if not is_custom and "_jinja_propagate" not in vars(cls):
            cls.propagate = MessagePassing.propagate  # PyG compiles no other
        super()._set_jittable_templates(raise_on_error)  # type: ignore[misc]
        if is_custom:
            return
        original = original_propagate()
        cls._orig_propagate = original
        if cls._jinja_propagate is MessagePassing.propagate:  # it could not be compiled
            cls._jinja_propagate = cls.propagate = original


def note_own_methods(cls: Any, layer: type, **methods: Iterable[str]) -> None:
    r"""Notes in a new subclass of a layer what it defines itself, and gives it a
    :meth:`propagate` of its own unless it has one.

    PyG puts compiled methods into the class of a layer that was made, so that the methods of a
    class tell nothing about it afterwards; what was there when the class was defined does.

    Args:
        cls (type): The subclass.
        layer (type): The layer.
        **methods: For each attribute that is set, the methods of which one has to be its own.
    """
    before = cls.__mro__[1 : cls.__mro__.index(layer)]
    parents = [base for base in before if issubclass(base, layer)]
    own = set(vars(cls)).union(*(vars(base) for base in before if base not in parents))
    for name, group in methods.items():
        has_own = not own.isdisjoint(group) or any(getattr(base, name) for base in parents)
        setattr(cls, name, has_own)
    if "propagate" not in own and not any(base._has_own_propagate for base in parents):
        cls.propagate = original_propagate()


def original_propagate() -> Any:
    r"""Returns PyG's :meth:`~torch_geometric.nn.MessagePassing.propagate`, uncompiled."""
    return vars(MessagePassing).get("_orig_propagate", MessagePassing.propagate)


def restore_propagate(model: Module) -> None:
    r"""Gives the layers of a model, also those of PyG and of users, the uncompiled
    :meth:`propagate` for an explainer, where a bare :obj:`MessagePassing()` took it from them.
    """
    compiled = vars(MessagePassing).get("_jinja_propagate")
    for layer in model.modules():
        kind: Any = type(layer)
        if compiled is not None and getattr(kind, "_orig_propagate", None) is compiled:
            kind._orig_propagate = original_propagate()


def _has_custom_propagate(cls: type) -> bool:
    known = (original_propagate(), MessagePassing.propagate)
    return any(
        vars(base)["propagate"] not in (*known, vars(base).get("_jinja_propagate"))
        for base in cls.__mro__
        if base is not MessagePassing and "propagate" in vars(base)
    )
