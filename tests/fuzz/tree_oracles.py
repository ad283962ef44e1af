"""Reference readers of JSON, YAML and XML, and whether what is read is the tree."""

import json
from typing import Any
from xml.etree import ElementTree

import numpy as np
from fuzz.laws import Refused


def strict_json(text: str) -> Any:
    """JSON with each key once, and finite numbers."""

    def pairs(items: list[tuple[str, Any]]) -> dict[str, Any]:
        need(len({key for key, _ in items}) == len(items))
        return dict(items)

    def finite(text: str) -> float:
        need(abs(float(text)) != float("inf"))
        return float(text)

    def refuse(text: str) -> Any:
        raise Refused(text)

    try:
        return json.loads(
            text, object_pairs_hook=pairs, parse_float=finite, parse_constant=refuse, strict=False
        )
    except (ValueError, RecursionError) as error:
        raise Refused(str(error)) from error


def json_tree(data: bytes) -> Any:
    try:
        return strict_json(data.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise Refused(str(error)) from error


def is_layout(tree: Any, found: dict[str, Any]) -> bool:
    """Whether a layout is the one of a JSON tree, key by key, and no key was passed over."""
    known = {"name", "source", "unit", "taxels", "adjacency"}
    known |= {f"{key}_names" for key in _INDICES}
    if not {*tree} <= known or tree["name"] != found["name"]:
        return False
    if tree.get("source", "") != found["source"] or len(tree["taxels"]) != len(found["taxels"]):
        return False
    if tree.get("adjacency", {}) != found["adjacency"]:
        return False
    if any(
        tree.get(f"{key}_names", found[f"{key}_names"]) != found[f"{key}_names"] for key in _INDICES
    ):
        return False
    metres = {"m": 1.0, "mm": 1e-3, "in": 0.0254}[tree["unit"]]
    for taxel, own in zip(tree["taxels"], found["taxels"], strict=True):
        if not {*taxel} <= {*own} or not np.allclose(
            np.multiply(taxel["pos"], metres), own["pos"], rtol=1e-5
        ):
            return False
        if any(taxel.get(key, own.get(key)) != own.get(key) for key in (*_INDICES, "cell")):
            return False
        if "normal" in taxel and not np.allclose(taxel["normal"], own["normal"], rtol=1e-3):
            return False
        if taxel.get("tangent", own.get("tangent")) != own.get("tangent"):
            return False
    return True


_INDICES = ("link", "patch", "digit")


def is_taxel_map(tree: Any, found: dict[str, Any]) -> bool:
    """Whether a map of taxels is the one of a JSON tree."""
    return bool({"layout": "", "source": "", **tree} == found)


def is_calibration(tree: Any, found: dict[str, Any]) -> bool:
    """Whether a calibration is the one of a JSON tree."""
    left_out = {"per": "taxel", "degree": 1, "source": "", "low": None, "high": None}
    tree = {**left_out, **tree}
    return tree.keys() == found.keys() and all(
        tree[key] == value if isinstance(value, str | int | None) else _same(tree[key], value)
        for key, value in found.items()
    )


def _same(written: Any, read: Any) -> bool:
    return np.array_equal(np.array(written, dtype=float), np.array(read))


def is_chain(tree: Any, found: dict[str, Any]) -> bool:
    """Whether a hand is the one of a JSON tree."""
    joints = tree["joints"]
    if not {*tree} <= {"name", "joints", "source", "bodies"} or len(joints) != len(found["joints"]):
        return False
    return tree.get("name", found["name"]) == found["name"] and all(
        _is_joint(joint, own) for joint, own in zip(joints, found["joints"], strict=True)
    )


def _is_joint(joint: dict[str, Any], own: dict[str, Any]) -> bool:
    joint, own = dict(joint), dict(own)
    axis, unit = joint.pop("axis", None), own.pop("axis", None)
    same = (axis is None) == (unit is None)
    if same and axis is not None:
        same = np.allclose(np.array(axis, float) / np.linalg.norm(np.array(axis, float)), unit)
    return same and all(key in own and _is_value(joint[key], own[key]) for key in joint)


def _is_value(written: Any, read: Any) -> bool:
    if type(written) is int and type(read) is float:  # 10**30 is no float
        return float(written) == read
    return bool(written == read)


def xml_tree(data: bytes) -> Any:
    def plain(element: ElementTree.Element) -> Any:
        text = (element.text or "").strip()
        return [element.tag, dict(element.attrib), text, [plain(child) for child in element]]

    try:
        return plain(ElementTree.fromstring(data))
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise Refused(str(error)) from error


def yaml_tree(data: bytes) -> Any:
    """YAML with each key once."""
    import yaml  # the core, whose tests read JSON only, is without it

    class _Once(yaml.SafeLoader):
        def construct_mapping(self, node: Any, deep: bool = False) -> Any:
            keys = [
                key.value for key, _ in getattr(node, "value", ()) if isinstance(key.value, str)
            ]
            need(len(set(keys)) == len(keys))
            return super().construct_mapping(node, deep)

    try:
        return yaml.load(data.decode("utf-8-sig"), Loader=_Once)
    except (yaml.YAMLError, ValueError, TypeError, RecursionError, AttributeError) as error:
        raise Refused(str(error)) from error


def need(condition: bool) -> None:
    if not condition:
        raise Refused
