r"""Conversion between layouts and text, for configurations."""

import json
from collections.abc import Mapping
from typing import Any

from torch_geometric_tactile.sensors import TaxelLayout, as_layout, stock_layout

_CONTENT_PREFIX = "layout="  # marks a text with the content of a layout instead of its name


def layout_from_text(text: str) -> TaxelLayout:
    r"""Returns the layout for a text in a configuration. The text is the name of a layout of the
    package, the path of a layout file, or the output of :func:`layout_to_text`.
    """
    if text.startswith(_CONTENT_PREFIX):
        return TaxelLayout.from_dict(json.loads(text.removeprefix(_CONTENT_PREFIX)))
    return as_layout(text)


def layout_to_text(layout: TaxelLayout) -> str:
    r"""Returns the shortest text that :func:`layout_from_text` reads on any machine: the name of a
    layout of the package, or otherwise the full content of the layout.
    """
    if _is_stock(layout):
        return layout.name
    # The prefix and the missing spaces prevent jsonargparse from parsing the text as a mapping if a
    # class accepts several types.
    content = json.dumps(layout.to_dict(), separators=(",", ":"))
    return _CONTENT_PREFIX + content.replace(" ", "\\u0020")


def plain_section(config: Mapping[str, Any]) -> dict[str, Any]:
    r"""Returns the output of :func:`~torch_geometric_tactile.training._sizes.fill_sizes` as plain
    data, with the layout as text.

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
