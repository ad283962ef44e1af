"""The pages on installing, on the command line and on errors say what the package does."""

import ast
import re
import tomllib
from importlib.util import find_spec
from pathlib import Path

import pytest
from packaging.version import Version

from torch_geometric_tactile import __version__
from torch_geometric_tactile.cli import build_parser
from torch_geometric_tactile.commands import COMMANDS

ROOT = Path(__file__).parents[1]
# Messages of other libraries, each produced in a test below or only by a GPU.
OTHERS = (
    "'knn_graph' requires 'pyg-lib>=0.6.0'",
    "`MessagePassing.propagate` only supports integer tensors of shape ...",
    "invalid value for environment variable MUJOCO_GL: ...",
)


def page(name):
    return (ROOT / "docs" / name).read_text(encoding="utf-8")


def template(node):
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else ""
    return "".join(v.value if isinstance(v, ast.Constant) else "\0" for v in node.values)


def templates():
    for path in (ROOT / "torch_geometric_tactile").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant | ast.JoinedStr):
                yield template(node)


def is_part(message, texts):
    """Whether the message, in which "..." stands for anything, is a part of one of the texts."""
    pieces = message.split("...")
    pattern = ".*".join(re.escape(piece) for piece in pieces)
    likely = (text for text in texts if max(pieces, key=len) in text)
    return any(re.search(pattern, text, flags=re.DOTALL) for text in likely)


def is_filled(message, known, texts):
    """Whether texts of the package in the places of a template make the message."""
    pieces = known.split("\0")
    if len(known) < 15 or not message.startswith(pieces[0]) or not message.endswith(pieces[-1]):
        return False
    pattern = "(.*)".join(re.escape(piece) for piece in pieces)
    match = re.fullmatch(pattern, message, flags=re.DOTALL)
    return match is not None and all(is_part(group, texts) for group in match.groups())


def quoted():
    return re.findall(r"```text\n(.*?)\n```", page("troubleshooting.md"), flags=re.DOTALL)


def test_quoted_messages_are_those_of_the_package():
    known = list(templates())
    messages = [message for message in quoted() if message not in OTHERS]
    assert len(messages) > 20
    filled = [message for message in messages if not is_part(message, known)]
    assert not [m for m in filled if not any(is_filled(m, text, known) for text in known)]


def test_quoted_messages_of_others_are_quoted():
    assert {*OTHERS} <= {*quoted()}


def test_pyg_layer_without_edges():
    import torch
    from torch_geometric.nn import GCNConv

    (message,) = (text for text in OTHERS if "propagate" in text)
    with pytest.raises(ValueError, match=re.escape(message.removesuffix("..."))):
        GCNConv(1, 1)(torch.zeros(2, 1), None)


def test_pyg_asks_for_its_extension_and_our_graph_does_not():
    if any(map(find_spec, ("pyg_lib", "torch_cluster"))):
        pytest.skip("the extension is installed")
    import torch
    from torch_geometric.data import Data
    from torch_geometric.transforms import KNNGraph as OfPyG

    from torch_geometric_tactile.transforms import KNNGraph

    data = Data(pos=torch.rand(5, 3))
    assert KNNGraph(k=2)(data).edge_index.size(1) >= 10
    with pytest.raises(ImportError, match=r"requires '(pyg-lib|torch-cluster)"):
        OfPyG(k=2)(data)


def test_notice_names_every_file_with_data_of_others():
    package = ROOT / "torch_geometric_tactile"
    folders = ("sensors/layouts", "sensors/chains", "live/taxel_maps")
    names = [path.name for folder in folders for path in (package / folder).glob("*.json")]
    notice = (ROOT / "NOTICE").read_text(encoding="utf-8")
    assert len(names) > 8
    assert not [name for name in names if name not in notice]


def test_install_lists_every_extra():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    listed = re.findall(r"^\| `(\w+)` \|", page("install.md"), flags=re.MULTILINE)
    assert listed
    assert sorted(listed) == sorted(project["optional-dependencies"])
    assert project["requires-python"] == ">=3.11"
    assert "Python 3.11 or later" in page("install.md")


def test_install_example_runs(capsys):
    (code,) = re.findall(r"```python\n(.*?)```", page("install.md"), flags=re.DOTALL)
    exec(code, {})
    assert capsys.readouterr().out == "torch.Size([32, 2])\n"


def test_command_line_lists_every_verb_with_its_help():
    rows = re.findall(r"^\| `tactile (\w+)` \| (.*?) \|", page("command_line.md"), re.MULTILINE)
    (commands,) = build_parser()._subparsers._group_actions
    helps = {action.dest: action.help for action in commands._choices_actions}
    assert dict(rows) == helps
    assert [name for name, _ in rows] == list(COMMANDS)


def test_command_line_lists_every_shipped_configuration():
    pytest.importorskip("yaml", reason="needs the extra 'train'")
    pytest.importorskip("lightning", reason="needs the extra 'train'")
    from torch_geometric_tactile.training._config import config_names
    from torch_geometric_tactile.training._config_files import TEMPLATES

    text = page("command_line.md")
    assert not [name for name in (*config_names(), *TEMPLATES) if f"`{name}" not in text]


def test_release_is_named_everywhere():
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    release, date = re.search(r"^## (\S+) \((\S+)\)$", changes, flags=re.MULTILINE).groups()
    assert Version(__version__) == Version(release) or Version(__version__).is_devrelease
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {release}\n" in citation
    assert f"\ndate-released: {date}\n" in citation
    assert f"version = {{{release}}}" in page("citation.md")
    assert f"version = {{{release}}}" in (ROOT / "README.md").read_text(encoding="utf-8")
    assert f"-{release}-py3-none-any.whl" in page("install.md")
