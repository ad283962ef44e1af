r"""Layers that keep the uncompiled form of PyG's :meth:`propagate` for explainers."""

from collections.abc import Iterable
from typing import Any

from torch.nn import Module
from torch_geometric.nn import MessagePassing


class ExplainablePropagate:
    r"""Compiles :meth:`propagate` separately for each class of layers, and keeps the uncompiled
    form, which explainers need. List this base class before
    :class:`~torch_geometric.nn.MessagePassing`.

    PyG replaces :meth:`propagate` in the class of the first layer that is created, and subclasses
    inherit the compiled form. If the first layer is a bare :obj:`MessagePassing()`, the layers of
    all packages lose the uncompiled form. The private names of PyG that are used here are tested
    with the oldest and the newest supported release.
    """

    def _set_jittable_templates(self, raise_on_error: bool = False) -> None:
        cls: Any = type(self)
        is_custom = _has_custom_propagate(cls)
        if not is_custom and "_jinja_propagate" not in vars(cls):
            cls.propagate = MessagePassing.propagate  # PyG compiles no other function
        super()._set_jittable_templates(raise_on_error)  # type: ignore[misc]
        if is_custom:
            return
        uncompiled = original_propagate()
        cls._orig_propagate = uncompiled
        if cls._jinja_propagate is MessagePassing.propagate:  # it could not be compiled
            cls._jinja_propagate = cls.propagate = uncompiled


def mark_overridden_methods(cls: Any, layer: type, **methods: Iterable[str]) -> None:
    r"""Sets attributes of a new subclass that indicate whether it overrides methods of a layer.
    Resets :meth:`propagate` to the uncompiled form unless the subclass overrides it.

    PyG later writes compiled methods into the classes of layers. Overridden methods can therefore
    be recognised only when the class is defined.

    Args:
        cls (type): The subclass.
        layer (type): The layer.
        **methods: Names of methods for each attribute. The attribute is :obj:`True` if one of
            these methods is overridden.
    """
    bases = cls.__mro__[1 : cls.__mro__.index(layer)]
    layer_subclasses = [base for base in bases if issubclass(base, layer)]
    defined_names = set(vars(cls)).union(
        *(vars(base) for base in bases if base not in layer_subclasses)
    )
    for attribute, names in methods.items():
        is_overridden = not defined_names.isdisjoint(names) or any(
            getattr(base, attribute) for base in layer_subclasses
        )
        setattr(cls, attribute, is_overridden)
    if "propagate" not in defined_names and not any(
        base._overrides_propagate for base in layer_subclasses
    ):
        cls.propagate = original_propagate()


def original_propagate() -> Any:
    r"""Returns the uncompiled form of PyG's
    :meth:`~torch_geometric.nn.MessagePassing.propagate`.
    """
    return vars(MessagePassing).get("_orig_propagate", MessagePassing.propagate)


def restore_propagate(model: Module) -> None:
    r"""Restores the uncompiled :meth:`propagate` in all layers of a model, including layers from
    PyG and from users, for use by an explainer. Layers lack the uncompiled form if a bare
    :obj:`MessagePassing()` was created before them.
    """
    compiled = vars(MessagePassing).get("_jinja_propagate")
    for layer in model.modules():
        cls: Any = type(layer)
        if compiled is not None and getattr(cls, "_orig_propagate", None) is compiled:
            cls._orig_propagate = original_propagate()


def _has_custom_propagate(cls: type) -> bool:
    pyg_methods = (original_propagate(), MessagePassing.propagate)
    return any(
        vars(base)["propagate"] not in (*pyg_methods, vars(base).get("_jinja_propagate"))
        for base in cls.__mro__
        if base is not MessagePassing and "propagate" in vars(base)
    )
