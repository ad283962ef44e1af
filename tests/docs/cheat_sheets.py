"""Writes docs/cheat_sheets.md. Each cell is read from the code or tried when this runs.

Examples:
    python tests/docs/cheat_sheets.py
"""

import inspect
import re
import sys
from collections.abc import Callable, Iterator
from operator import itemgetter
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import small_models

from torch_geometric_tactile import datasets, nn, transforms
from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile.nn import conv, pool
from torch_geometric_tactile.sensors import layout_sectors, letter_array

TEMPLATE = Path(__file__).with_suffix(".md.in")
DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGE = DOCS / "cheat_sheets.md"
DATA_SETS_PAGE = DOCS / "data_sets.md"
TABLES_OF_DATA_SETS = re.compile(
    r"(<!-- tables by tests/docs/cheat_sheets.py -->\n\n).*?(\n\n<!-- end of the tables -->)",
    re.DOTALL,
)
N, EDGES = 11, small_models.EDGE_INDEX
SECTOR_EDGES, SECTOR = layout_sectors(small_models.LAYOUT)
YES, NO = "yes", "-"

# How a layer is made for a number of input channels, and what it gets for a number of samples.
Layer = tuple[Callable[[int], torch.nn.Module], Callable[[int], tuple[Any, ...]]]


def _taxels(batch: int) -> Tensor:
    return small_models.samples(batch, N, 3)


def _edges(batch: int) -> Tensor:
    return small_models.samples(batch, EDGES.size(1), 4)


LAYERS: dict[str, Layer] = {
    "StaticGCNConv": (lambda f: conv.StaticGCNConv(f, 8), lambda b: (_taxels(b), EDGES)),
    "StaticGATConv": (lambda f: conv.StaticGATConv(f, 8), lambda b: (_taxels(b), EDGES)),
    "StaticGATv2Conv": (lambda f: conv.StaticGATv2Conv(f, 8), lambda b: (_taxels(b), EDGES)),
    "SegmentedGCNConv": (
        lambda f: conv.SegmentedGCNConv(small_models.PATCH, f, 8),
        lambda b: (_taxels(b), EDGES),
    ),
    "SelfGCNConv": (lambda f: conv.SelfGCNConv(f, 8), lambda b: (_taxels(b), EDGES)),
    "SectorConv": (
        lambda f: conv.SectorConv(f, 8),
        lambda b: (_taxels(b), SECTOR_EDGES, SECTOR),
    ),
    "CausalTemporalConv": (
        lambda f: conv.CausalTemporalConv(f, 8),
        lambda b: (small_models.samples(b, N, 6, 3),),
    ),
    "EdgeFeatureEncoder": (
        lambda f: conv.EdgeFeatureEncoder(N, EDGES.size(1), f),
        lambda b: (_edges(b), EDGES),
    ),
    "EdgeMessageEncoder": (
        lambda f: conv.EdgeMessageEncoder(f),
        lambda b: (_edges(b), EDGES, N),
    ),
    "EdgeAttentionEncoder": (
        lambda f: conv.EdgeAttentionEncoder(f),
        lambda b: (_edges(b), EDGES, N),
    ),
    "EdgePatchEncoder": (
        lambda f: conv.EdgePatchEncoder(small_models.PATCH, f),
        lambda b: (_edges(b), EDGES, N),
    ),
    "BilinearFeature": (
        lambda f: pool.BilinearFeature(),
        lambda b: (small_models.samples(b, 3, 8, 8),),
    ),
    "ChannelMaxPool": (lambda f: pool.ChannelMaxPool(3), lambda b: (_taxels(b),)),
    "TaxelPool": (
        lambda f: pool.TaxelPool(small_models.LAYOUT, "patch"),
        lambda b: (_taxels(b),),
    ),
}
WEIGHTLESS = ("BilinearFeature", "ChannelMaxPool", "TaxelPool")
# Kind, question, frames a second, licence, where it comes from, and what a split should hold out.
DATA_SETS = {
    "BioTacSP": (
        "real",
        "slip or stable, from one reading of three fingertips",
        "single readings",
        "MIT",
        "downloaded, 2 MB",
        'objects and sessions (`Protocol("given")`)',
    ),
    "BioTacSPDoS": (
        "real",
        "direction of slip",
        "100",
        "none stated",
        "its authors' repository",
        'objects (`Protocol("given")`)',
    ),
    "ICubGrasp": (
        "real",
        "which of ten objects is grasped",
        "not stated",
        "free with its notice",
        "its author's page, 2 MB",
        "trials; the first frame reveals the object",
    ),
    "EFleshSlip": (
        "real",
        "slip or hold, on a magnetic skin",
        "100",
        "MIT",
        "downloaded, 5 MB",
        'runs (`Protocol("given")`); the first frame reveals the run',
    ),
    "PressureMat": (
        "real",
        "posture on a mat: 17 (I), 29 (II) or 3 sides",
        "1 (I), single frames (II)",
        "ODC-BY 1.0",
        "downloaded, 31 MB",
        "persons; in II also mattresses",
    ),
    "BiGS": (
        "real",
        "whether a grasp holds",
        "100",
        "not stated",
        "`tactile convert bigs` from the original",
        "objects",
    ),
    "LetterShape": (
        "real",
        "which letter is pressed",
        "single frames",
        "private",
        "its authors, or your own press",
        "presses",
    ),
    "AllegroUSkin": (
        "your own",
        "object or property, from 384 taxels",
        "any",
        "yours",
        "`tactile simulate`",
        "trials, then objects",
    ),
    "DigitImages": (
        "real (ink)",
        "which digit",
        "single images",
        "UCI's; MNIST's",
        "with scikit-learn, or MNIST's files, 12 MB",
        "writers (MNIST's parts)",
    ),
    "FakeTactileDataset": (
        "generated",
        "slip or stable",
        "single readings",
        "ours",
        "generated when created",
        "objects and sessions",
    ),
    "RecordingFrames": (
        "your own",
        "any label of any recordings",
        "any",
        "yours",
        "your folder",
        "trials, then objects",
    ),
    "SamplesFile": (
        "your own",
        "any label of any arrays",
        "any",
        "yours",
        "your npz file",
        "samples that were measured together",
    ),
    "SparshSkin": (
        "real",
        "which of 14 objects is in the hand",
        "100, of which 10 are read",
        "see its card",
        "Hugging Face, by one command",
        "episodes",
    ),
    "USkinPick": (
        "real",
        "whether a gripper drops the box",
        "about 37",
        "none stated",
        "its authors' repository",
        'objects (`Protocol("given")` by `seen`); rows repeat',
    ),
    "BioTacSlide": (
        "real",
        "which of 20 materials",
        "100",
        "none stated",
        "its authors' repository",
        "slides; slides over a material are consecutive",
    ),
    "BrailleLetters": (
        "real",
        "which Braille letter",
        "40",
        "CC BY 4.0",
        "Zenodo; you convert it",
        "slides; one print of each letter",
    ),
    "TactileGlove": (
        "real",
        "which of 26 objects, or none",
        "see `time`",
        "its own, research only",
        "its authors' page",
        'recordings (`Protocol("given")`, or sessions)',
    ),
}


def _tried(attempt: Callable[[], object]) -> str:
    try:
        attempt()
    except Exception:
        return NO
    return YES


def _block_diagonal(make: Callable[[int], torch.nn.Module], inputs: tuple[Any, ...]) -> None:
    layer, (x, *edges) = make(x_channels(inputs)), inputs
    size, num_samples = x.size(1), len(x)
    if edges and torch.equal(edges[0], EDGES):
        size = N
    shifted = [edge + size * i for edge in edges[:1] for i in range(num_samples)]
    index = [torch.cat(shifted, dim=1)] if shifted else []
    more = [e.repeat(num_samples) if isinstance(e, Tensor) else e * num_samples for e in edges[1:]]
    torch.manual_seed(0)
    flat = layer(x.flatten(0, 1), *index, *more)
    expected = layer(*inputs)
    torch.testing.assert_close(flat.view_as(expected), expected, rtol=1e-4, atol=1e-5)


def x_channels(inputs: tuple[Any, ...]) -> int:
    """Number of channels of a layer's input."""
    return int(inputs[0].size(-1))


def _loop(make: Callable[[int], torch.nn.Module], inputs: tuple[Any, ...]) -> None:
    layer, (x, *rest) = make(x_channels(inputs)), inputs
    expected = torch.stack([layer(sample, *rest) for sample in x])
    torch.testing.assert_close(layer(*inputs), expected, rtol=1e-4, atol=1e-5)


def layer_row(name: str) -> tuple[str, ...]:
    """Returns what a layer can do, by trying it."""
    make, given = LAYERS[name]
    inputs = given(4)
    channels = x_channels(inputs)
    torch._dynamo.reset()
    compiled = torch.compile(make(channels), backend="eager", fullgraph=True)
    return (
        f"`{name}`",
        _tried(lambda: _loop(make, inputs)),
        _tried(lambda: _block_diagonal(make, inputs)),
        YES if inputs[0].size(-2) == EDGES.size(1) else NO,
        NO if name in WEIGHTLESS else _tried(lambda: make(-1)(*inputs)),
        _tried(lambda: (compiled(*inputs), torch.export.export(make(channels).eval(), inputs))),
    )


def _stats(name: str) -> tuple[str, str, str, str]:
    """Taxels, channels, samples and classes of a data set: of the table in its docstring."""
    lines = inspect.getdoc(getattr(datasets, name)).splitlines()
    starts = [i for i, line in enumerate(lines) if "list-table:: STATS" in line]
    if not starts:
        return ("any",) * 4
    cells = []
    for line in lines[starts[0] + 1 :]:
        if line and not line.startswith(" "):
            break
        found = re.match(r"\s+(\*)?\s*- (.+)", line)
        if found:
            cells += [[]] if found[1] else []
            cells[-1].append(found[2].strip())
    table = [dict(zip(cells[0], row, strict=True)) for row in cells[1:]]
    samples = next((key for key in ("#graphs", "#samples", "#trials") if key in table[0]), "")
    what = {"#trials": " grasps"}.get(samples, "")
    published = ", published" if "published" in lines[starts[0]] else ""
    counts = " + ".join(row[samples] for row in table) + what + published
    first = table[0]
    return first["#nodes"], first["#features"], counts, first["#classes"]


def data_set_rows() -> Iterator[tuple[str, ...]]:
    """Yields the data sets with their sizes, of the tables in their docstrings."""
    for name, (kind, question, *rest) in DATA_SETS.items():
        yield f"`{name}`", kind, question, *_stats(name), *rest


def transform_rows() -> Iterator[tuple[str, ...]]:
    """Yields the transforms with the names and kinds that the code gives them."""
    for name in sorted(transforms.__all__):
        transform = getattr(transforms, name)
        bases = (transforms.FittedTransform, transforms.TactileTransform)
        if not inspect.isclass(transform) or transform in bases:
            continue
        text = " ".join(inspect.getdoc(transform).split())
        functional = re.search(r"functional name: :obj:`(\w+)`", text)[1]
        yield (
            f"`{name}`",
            f"`{functional}`",
            YES if issubclass(transform, transforms.FittedTransform) else NO,
            YES if transform.is_random else NO,
            YES if name in OF_WINDOWS else NO,
        )


MODELS = {
    "TaxelNet": "ours: default for one frame, on any layout",
    "PosedTaxelNet": "ours: taxels placed by joint angles, metric answers",
    "TemporalTaxelNet": "ours: graph model for windows and streams",
    "SmallCNN": "baseline: plain CNN",
    "TemporalCNN": "baseline: plain CNN over time",
    "TactileGCN": "P1, P2 (methods T, E, A and X, I, II)",
    "MTGCN": "P1 (MT-GCN)",
    "MTCNN": "P1, CNN with several threads",
    "HandCNN": "P1, P2, CNN",
    "TactileFNN": "P1, P2, fully connected network",
    "GraspGCN": "P3 (GCN-DF, GCN-FF)",
    "GraspLSTM": "P3, LSTM",
    "MSCNN": "P4 (MS-CNN)",
    "BMFCNN": "P5 (BMF-CNN)",
}
OF_WINDOWS = ("ContactCrop", "RandomTimeShift", "Resample")
# Sensors and answers of the models without defaults for them.
SENSORS = {
    "TaxelNet": ("allegro_uskin", 6),
    "PosedTaxelNet": ("allegro_uskin", 6),
    "TemporalTaxelNet": ("biotac", 2),
    "SmallCNN": ("allegro_uskin", 6),
    "TemporalCNN": ("biotac", 2),
}
WINDOWS = ("GraspGCN", "GraspLSTM", "TemporalCNN", "TemporalTaxelNet")


def _input_of(name: str) -> str:
    return "window" if name in WINDOWS else "frame"


def model_rows() -> Iterator[tuple[str, ...]]:
    """Yields what the models need, and their weights with their default arguments or SENSORS."""
    for name, what in MODELS.items():
        make = getattr(nn.models, name)
        if name == "MTGCN":
            model = make(num_edges=1401)
        elif name == "GraspGCN":
            model = make(19, in_channels=60)  # as P3
        elif name == "BMFCNN":
            model = make(letter_array(), 26)
        else:
            # The weights of the papers' fully connected network would take a gigabyte.
            with torch.device("meta" if name == "TactileFNN" else "cpu"):
                model = make(*SENSORS.get(name, ()))
        yield (
            f"`{name}`",
            what,
            "window, or frame by frame" if hasattr(model, "step") else _input_of(name),
            YES if getattr(model, "needs_edges", False) else NO,
            YES
            if "num_joints" in inspect.signature(make).parameters or name == "PosedTaxelNet"
            else NO,
            f"{sum(w.numel() for w in model.parameters()):,}",
        )


def page() -> str:
    """Returns the text of the page."""
    sections = {
        "layers": _table(
            (
                "layer",
                "`(B, N, F)`",
                "PyG batch",
                "edge features",
                "lazy (`-1`)",
                "compile and export",
            ),
            *(layer_row(name) for name in (*conv.__all__, *pool.__all__)),
        ),
        "models": _table(
            ("model", "from", "input", "edges", "joint angles", "weights"),
            *model_rows(),
        ),
        "transforms": _table(
            ("transform", "functional name", "fitted", "augmentation", "windows only"),
            *transform_rows(),
        ),
    }
    return TEMPLATE.read_text().format(
        **{name.replace(" ", "_"): table for name, table in sections.items()}
    )


def data_sets_page() -> str:
    """Returns the text of the page on published data sets, with its tables as in the code."""
    rows = list(data_set_rows())
    sizes = _table(
        ("data set", "data", "question", "taxels", "samples", "classes"),
        *map(itemgetter(0, 1, 2, 3, 5, 6), rows),
    )
    sources = _table(
        ("data set", "channels", "Hz", "licence", "from", "hold out"),
        *map(itemgetter(0, 4, 7, 8, 9, 10), rows),
    )
    text = DATA_SETS_PAGE.read_text()
    return TABLES_OF_DATA_SETS.sub(rf"\g<1>{sizes}\n\n{sources}\g<2>", text)


def main() -> None:
    for path, text in ((PAGE, page()), (DATA_SETS_PAGE, data_sets_page())):
        with atomic_path(path) as temporary:
            temporary.write_text(text)


def _table(*rows: tuple[str, ...]) -> str:
    head, *body = rows
    lines = [head, tuple("---" for _ in head), *body]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


if __name__ == "__main__":
    main()
