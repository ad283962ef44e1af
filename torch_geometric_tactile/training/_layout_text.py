r"""Layouts as text."""

import json
from collections.abc import Mapping
from typing import Any

from torch_geometric_tactile.sensors import TaxelLayout, as_layout, stock_layout

_CONTENT = "layout="  # in front of the content of a layout


def layout_from_text(text: str) -> TaxelLayout:
    r"""Returns the layout that a configuration names: one that comes with the package, a layout
    file, or what :func:`layout_to_text` returned.
    """
    if text.startswith(_CONTENT):
        return TaxelLayout.from_dict(json.loads(text.removeprefix(_CONTENT)))
    return as_layout(text)


def layout_to_text(layout: TaxelLayout) -> str:
    r"""Returns the shortest text that :func:`layout_from_text` reads anywhere: the name of a layout
    that comes with the package, or else its whole content.
    """
    if _is_stock(layout):
        return layout.name
    # Without a space, and not a mapping at first sight: the parser of configurations would take it
    # for one wherever a class accepts texts of several kinds.
    content = json.dumps(layout.to_dict(), separators=(",", ":"))
    return _CONTENT + content.replace(" ", "\\u0020")


def plain_section(config: Mapping[str, Any]) -> dict[str, Any]:
    r"""Returns what :func:`~torch_geometric_tactile.training.sizes.fill_sizes` returned as plain
    data, with the text of a layout.

    Args:
        config (Mapping): The :obj:`model` section.
    """
    model = config.get("model")
    arguments = model.get("init_args") if isinstance(model, Mapping) else None
    if not isinstance(arguments, Mapping) or not isinstance(arguments.get("layout"), TaxelLayout):
        return dict(config)
    plain = {**arguments, "layout": layout_to_text(arguments["layout"])}
    return {**config, "model": {**model, "init_args": plain}}  # type: ignore[dict-item]


def _is_stock(layout: TaxelLayout) -> bool:
    try:
        return stock_layout(layout.name).matches(layout)
    except ValueError:
        return False
