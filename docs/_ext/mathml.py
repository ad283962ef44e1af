"""Writes formulas as MathML when the site is built, so that pages need no script."""

import re
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.writers.html5 import HTML5Translator

_logger = logging.getLogger(__name__)


def to_mathml(latex: str, block: bool = False) -> str:
    """Returns a formula as MathML.

    Args:
        latex (str): The formula, without dollars.
        block (bool): Whether it stands in a paragraph of its own.

    Raises:
        ValueError: If the formula has a command that is not known.
    """
    latex = re.sub(r"\\(begin|end)\{aligned\}", r"\\\1{split}", latex)  # the same, and known
    if block and ("\\\\" in latex or "&" in latex) and "\\begin" not in latex:
        latex = rf"\begin{{split}}{latex}\end{{split}}"
    try:
        text = convert(latex, display="block" if block else "inline")
    except Exception as error:  # the converter raises classes of many kinds
        raise ValueError(f"the formula '{latex}' cannot be converted ({error!r})") from error
    plain = latex.replace(r"\{", "").replace(r"\}", "")
    if plain.count("{") != plain.count("}"):
        raise ValueError(f"the formula '{latex}' must close all its braces")
    # What the converter does not know is left as it is.
    if "\\" in text or "<mi>&</mi>" in text or "linebreak" in text:
        raise ValueError(f"the formula '{latex}' has a command that is not known")
    return text


def _write(translator: HTML5Translator, node: nodes.Element, block: bool) -> None:
    tag = "div" if block else "span"
    try:
        text = to_mathml(node.astext(), block)
    except ValueError as error:
        _logger.warning("%s", error, location=node, type="mathml")
        text = translator.encode(node.astext())
    translator.body.append(translator.starttag(node, tag, "", CLASS="math") + text + f"</{tag}>")
    raise nodes.SkipNode


def _visit_inline(translator: HTML5Translator, node: nodes.Element) -> None:
    _write(translator, node, False)


def _visit_block(translator: HTML5Translator, node: nodes.Element) -> None:
    _write(translator, node, True)


def setup(app: Sphinx) -> dict[str, Any]:
    """Adds the renderer `mathml`."""
    app.add_html_math_renderer("mathml", (_visit_inline, None), (_visit_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
