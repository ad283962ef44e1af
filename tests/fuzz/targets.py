"""What is attacked: a reader, whole files to start from, mutations, and a reference reader."""

import io
import json
import warnings
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from random import Random
from typing import Any

import yaml
from fuzz import (
    bases,
    description_bases,
    lerobot_sets,
    matrix_bases,
    matrix_mutations,
    mcap_mutations,
    model_bases,
    oracles,
    pickle_mutations,
    readers,
    stream_bases,
    stream_oracles,
    tree_oracles,
)
from fuzz.bytes_mutations import BYTES
from fuzz.hdf5_mutations import mutate_fields, mutate_hdf5
from fuzz.laws import JUDGED, REFUSED, REWRITTEN, Refused, equal
from fuzz.npz_mutations import mutated_npz, mutated_samples
from fuzz.text_mutations import TEXT, encoded
from fuzz.torch_mutations import harmful, mutated_tensor, mutated_torch, with_harm
from fuzz.tree_mutations import as_json, as_yaml, mutated_tree

Mutate = Callable[[Path, bytes, Random, bytes], str]
"""Writes a mutated file, given its path, the whole file, and another one; returns what is allowed.
"""


@dataclass(frozen=True)
class Target:
    """A reader under attack.

    Args:
        name (str): Its name.
        make (callable): Writes whole files into a folder.
        read (callable): Reads a file; returns plain values.
        mutate (callable): Writes a mutated file.
        says (callable, optional): Of a text format, the reference reader.
        tree (bool): Whether :obj:`says` returns the tree that the file holds instead of the
            reading.
        agrees (callable, optional): Compares such a tree with a reading.
        weight (int): How many of a hundred cases, about.
        suffix (str): Files of other suffixes are needed beside, and not mutated.
        names_file (bool): Whether an error must name the file.
    """

    name: str
    make: Callable[[Path], None]
    read: Callable[[Path], Any]
    mutate: Mutate
    says: Callable[[bytes], Any] | None = None
    weight: int = 4
    tree: bool = False
    agrees: Callable[[Any, Any], bool] = lambda tree, found: True
    suffix: str = ""
    names_file: bool = True

    def judged(self, data: bytes, mutated: bytes, before: Any, found: Any, allowed: str) -> str:
        """The outcome of a mutated file that was read."""
        if allowed == REFUSED:
            return "silent"
        if equal(found, before):
            return "same"
        if allowed == REWRITTEN:
            return "rewritten"
        if self.says is None:
            return "silent"
        try:
            said = self.says(mutated)
        except Refused:
            return "silent"
        if not self.tree:
            return "cell" if equal(found, said) else "silent"
        if equal(said, self.says(data)) or not self.agrees(said, found):
            return "silent"
        return "cell"


def _bytes(path: Path, data: bytes, draw: Random, other: bytes) -> str:
    path.write_bytes(draw.choice(BYTES)(data, draw, other))
    return JUDGED


def _text(path: Path, data: bytes, draw: Random, other: bytes) -> str:
    if draw.random() < 0.4:
        return _bytes(path, data, draw, other)
    text = data.decode()
    for _ in range(draw.choice([1, 1, 1, 2])):
        text = draw.choice(TEXT)(text, draw) or "\n"
    path.write_bytes(encoded(text, draw))
    return JUDGED


def _one_of_several(path: Path, data: bytes, draw: Random, other: bytes) -> str:
    """A table that is read together with others, so that no reference reader sees it whole."""
    _text(path, data, draw, other)
    return REWRITTEN


def _spaced(path: Path, data: bytes, draw: Random, other: bytes) -> str:
    """Text mutations of cells that are separated by blanks."""
    if draw.random() < 0.4:
        return _bytes(path, data, draw, other)
    text = "\n".join(",".join(line.split()) for line in data.decode().splitlines()) + "\n"
    for _ in range(draw.choice([1, 1, 1, 2])):
        text = draw.choice(TEXT)(text, draw) or "\n"
    path.write_bytes(encoded(text.replace(",", " "), draw))
    return JUDGED


def _mat_zip(path: Path, data: bytes, draw: Random, other: bytes) -> str:
    """A mutation of the archive, or of a text file in it."""
    if draw.random() < 0.5:
        return _bytes(path, data, draw, other)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    name = draw.choice(list(files)[1:])
    packing = draw.choice([zipfile.ZIP_DEFLATED] * 4 + [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
    members = list(files.items())
    if draw.random() < 0.2:  # a second file of the same name, or one that is not listed
        second = draw.choice([name, f"other/{name.partition('/')[2]}", name.replace("/S1", "/S3")])
        members.insert(draw.randrange(len(members)), (second, b"7 7\n"))
    else:
        inner = path.with_suffix(".txt")
        _spaced(inner, files[name], draw, b"7 7\n")
        members[list(files).index(name)] = (name, inner.read_bytes())
        inner.unlink()
    with warnings.catch_warnings(), zipfile.ZipFile(path, "w", packing) as archive:
        warnings.simplefilter("ignore")  # of a name that is there twice
        for key, text in members:
            archive.writestr(key, text)
    return JUDGED


def _json(path: Path, data: bytes, draw: Random, other: bytes) -> str:
    if draw.random() < 0.4:
        return _bytes(path, data, draw, other)
    tree = json.loads(data)
    for _ in range(draw.choice([0, 1, 1, 1, 2])):
        if tree:
            tree = mutated_tree(tree, draw)
    path.write_bytes(encoded(as_json(tree, draw), draw))
    return JUDGED


def _json_lines(path: Path, data: bytes, draw: Random, other: bytes) -> str:
    if draw.random() < 0.4:
        return _text(path, data, draw, other)
    lines = data.decode().splitlines()
    place = draw.choice([i for i, line in enumerate(lines) if line.startswith("{")])
    lines[place] = as_json(mutated_tree(json.loads(lines[place]), draw), draw)
    path.write_bytes(encoded("\n".join(lines) + "\n", draw))
    return JUDGED


def _live_json(path: Path, data: bytes, draw: Random, other: bytes) -> str:
    """A message of a server, which the reader itself compares with what the slow parser says."""
    if draw.random() < 0.5:
        _bytes(path, data, draw, other)
    else:
        tree = mutated_tree(json.loads(data, strict=False), draw)
        path.write_bytes(encoded(as_json(tree, draw), draw))
    return REWRITTEN


def _yaml(path: Path, data: bytes, draw: Random, other: bytes) -> str:
    kind = draw.random()
    if kind < 0.3:
        return _bytes(path, data, draw, other)
    tree = yaml.safe_load(data)
    tree = with_harm(tree, draw) if kind < 0.6 else mutated_tree(tree, draw)
    path.write_bytes(encoded(as_yaml(tree, draw), draw))
    return JUDGED


def _npz(path: Path, data: bytes, draw: Random, other: bytes) -> str:
    if draw.random() < 0.5:
        return _bytes(path, data, draw, other)
    content, allowed = mutated_npz(data, draw)
    path.write_bytes(content)
    return allowed


def _samples_npz(path: Path, data: bytes, draw: Random, other: bytes) -> str:
    if draw.random() < 0.5:
        return _bytes(path, data, draw, other)
    content, allowed = mutated_samples(data, draw)
    path.write_bytes(content)
    return allowed


def _hdf5(path: Path, data: bytes, draw: Random, other: bytes) -> str:
    if draw.random() < 0.5:
        return _bytes(path, data, draw, other)
    path.write_bytes(data)
    return mutate_hdf5(path, draw)


def _fields_hdf5(path: Path, data: bytes, draw: Random, other: bytes) -> str:
    """A file of others has no checksums of ours: what is flipped may read as another number."""
    if draw.random() < 0.5:
        _bytes(path, data, draw, other)
        return REWRITTEN
    path.write_bytes(data)
    return mutate_fields(path, draw)


def _torch(path: Path, data: bytes, draw: Random, other: bytes) -> str:
    if draw.random() < 0.4:
        return _bytes(path, data, draw, other)
    content, allowed = mutated_torch(data, draw)
    path.write_bytes(content)
    return allowed


def _tensor(path: Path, data: bytes, draw: Random, other: bytes) -> str:
    if draw.random() < 0.4:
        return _bytes(path, data, draw, other)
    content, allowed = mutated_tensor(data, draw)
    path.write_bytes(content)
    return allowed


def _predictor(path: Path, data: bytes, draw: Random, other: bytes) -> str:
    """Its header with another tree in it, and its old checksums."""
    if draw.random() < 0.5:
        return _bytes(path, data, draw, other)
    length = int.from_bytes(data[:8], "little")
    header = json.loads(data[8 : 8 + length])
    if draw.random() < 0.3:
        header = mutated_tree(header, draw)
    else:
        key = draw.choice([*header.get("__metadata__", {})] or [""])
        text = header["__metadata__"][key]
        try:
            tree = json.loads(text)
        except ValueError:
            tree = {"a": text}
        if isinstance(tree, dict):
            tree = mutated_tree(tree, draw)
            if draw.random() < 0.3:
                tree["model"] = harmful(draw)
        header["__metadata__"][key] = json.dumps(tree)
    text = as_json(header, draw).encode("utf-8", "surrogatepass")
    path.write_bytes(len(text).to_bytes(8, "little") + text + data[8 + length :])
    return JUDGED


def _stream(protocol: str, weight: int) -> Target:
    return Target(
        f"stream: {protocol}",
        getattr(stream_bases, protocol),
        stream_bases.reader(protocol),
        _bytes,
        getattr(stream_oracles, protocol),
        weight,
    )


TARGETS: Sequence[Target] = (
    Target("wide CSV", bases.wide_csv, readers.wide_csv, _text, oracles.wide_csv, 8),
    Target(
        "annotations CSV",
        bases.annotations_csv,
        readers.annotations_csv,
        _text,
        oracles.annotations_csv,
    ),
    Target("labels CSV", bases.labels_csv, readers.labels_csv, _text, oracles.labels_csv),
    Target("named CSV", bases.named_csv, readers.named_csv, _text, oracles.named_csv, 5),
    Target("named CSV, Excel", bases.excel_csv, readers.excel_csv, _text, oracles.excel_csv),
    Target(
        "named CSV, given names",
        bases.given_names_csv,
        readers.given_names_csv,
        _text,
        partial(oracles.named_csv, **readers.GIVEN_NAMES),
        4,
    ),
    Target("XELA log", bases.xela_log_both, readers.xela_log, _text, oracles.xela_log, 5),
    Target(
        "XELA log, forces",
        bases.xela_log,
        readers.xela_log_forces,
        _text,
        partial(oracles.xela_log, forces=True),
        3,
    ),
    Target(
        "XELA messages",
        bases.xela_messages,
        readers.xela_messages,
        _json_lines,
        oracles.xela_messages,
        7,
    ),
    Target("XELA live", bases.xela_live, readers.xela_live, _live_json, weight=4),
    Target("BioTac SP CSV", bases.biotac_csv, readers.biotac_csv, _text, oracles.biotac_csv, 5),
    Target("BioTac SP DoS CSV", bases.dos_csv, readers.dos_csv, _text, oracles.dos_csv, 4),
    Target("BioTac slide CSV", bases.slide_csv, readers.slide_csv, _text, oracles.slide_csv, 4),
    Target(
        "uSkin pick",
        bases.uskin_pick,
        readers.uskin_pick,
        _one_of_several,
        weight=4,
        suffix=".csv",
    ),
    Target(
        "Sparsh-skin", bases.sparsh_skin, readers.sparsh_skin, pickle_mutations.mutate, weight=4
    ),
    Target("BiGS npz", bases.bigs_npz, readers.bigs, _samples_npz, weight=4),
    Target("BiGS HDF5", bases.bigs_hdf5, readers.bigs, _fields_hdf5, weight=4),
    Target("iCub Grasp text", bases.icub_txt, readers.icub_txt, _spaced, oracles.icub_txt, 4),
    Target("pressure mat zip", matrix_bases.mat_zip, readers.mat_zip, _mat_zip, oracles.mat_zip, 4),
    Target(
        "pressure mat checksums",
        matrix_bases.mat_zip,
        readers.mat_zip_hash,
        _mat_zip,
        oracles.mat_zip_hash,
    ),
    Target("eFlesh sequence", matrix_bases.eflesh_sequence, readers.eflesh_sequence, _tensor),
    *(
        Target(
            f"eFlesh {name}",
            bases.eflesh_probe,
            readers.eflesh_probe,
            _text,
            says,
            suffix=f"{name}.csv",
            names_file=False,  # but the folder
        )
        for name, says in (
            ("sensor", lambda data: oracles.eflesh_probe(data, bases.EFLESH[1])),
            ("states", lambda data: oracles.eflesh_probe(bases.EFLESH[0], data)),
        )
    ),
    Target("matrix CSV", matrix_bases.csv, readers.matrix, _text, oracles.matrix_csv, 4),
    Target("matrix npy", matrix_bases.npy, readers.matrix, matrix_mutations.npy, weight=4),
    Target("matrix PNG", matrix_bases.png, readers.matrix, matrix_mutations.png, weight=4),
    Target("matrix MAT", matrix_bases.mat, readers.matrix, matrix_mutations.mat, weight=5),
    Target(
        "MAT variables",
        matrix_bases.mat_variables,
        readers.mat_variables,
        matrix_mutations.mat,
        weight=5,
    ),
    Target("IDX", matrix_bases.idx, readers.idx, matrix_mutations.idx, weight=3),
    Target("npz", bases.npz, readers.npz, _npz, weight=8),
    Target("MCAP", bases.mcap, readers.mcap, mcap_mutations.mutate, weight=6),
    Target(
        "recovered MCAP",
        bases.mcap,
        readers.recovered_mcap,
        mcap_mutations.mutate,
        says=lambda data: data,
        weight=6,
        tree=True,
        agrees=oracles.is_part_of_mcap,
    ),
    Target("samples npz", bases.samples_npz, readers.samples_npz, _samples_npz, weight=4),
    Target("HDF5", bases.hdf5, readers.hdf5, _hdf5, weight=7),
    Target("HDF5, appended", bases.hdf5_appended, readers.hdf5, _hdf5, weight=7),
    Target(
        "LeRobot",
        lerobot_sets.make,
        lerobot_sets.read,
        lerobot_sets.mutate,
        weight=6,
        suffix=lerobot_sets.SUFFIX,
    ),
    Target("recording: CSV", bases.wide_csv, readers.any_recording, _text, oracles.wide_csv, 3),
    Target("recording: npz", bases.npz, readers.any_recording, _npz, weight=2),
    Target("recording: HDF5", bases.hdf5, readers.any_recording, _hdf5, weight=2),
    Target(
        "layout",
        description_bases.layout,
        readers.layout,
        _json,
        tree_oracles.json_tree,
        4,
        tree=True,
        agrees=tree_oracles.is_layout,
    ),
    Target(
        "layout of patches",
        description_bases.patches,
        readers.layout,
        _json,
        tree_oracles.json_tree,
        4,
        tree=True,
    ),
    Target(
        "calibration",
        description_bases.calibration,
        readers.calibration,
        _json,
        tree_oracles.json_tree,
        4,
        tree=True,
        agrees=tree_oracles.is_calibration,
    ),
    Target(
        "taxel map",
        description_bases.taxel_map,
        readers.taxel_map,
        _json,
        tree_oracles.json_tree,
        3,
        tree=True,
        agrees=tree_oracles.is_taxel_map,
    ),
    Target(
        "chain",
        description_bases.chain,
        readers.chain,
        _json,
        tree_oracles.json_tree,
        3,
        tree=True,
        agrees=tree_oracles.is_chain,
    ),
    Target(
        "URDF", description_bases.urdf, readers.urdf, _text, tree_oracles.xml_tree, 2, tree=True
    ),
    Target("predictor", model_bases.predictor, readers.predictor, _predictor, weight=6),
    Target(
        "predictor of an estimator", model_bases.estimator, readers.predictor, _predictor, weight=3
    ),
    Target("checkpoint: predictor", model_bases.checkpoint, readers.predictor, _torch, weight=5),
    Target("checkpoint: module", model_bases.checkpoint, readers.checkpoint, _torch, weight=4),
    Target("processed file", model_bases.processed, readers.processed, _torch, weight=5),
    Target(
        "configuration",
        model_bases.config,
        readers.config,
        _yaml,
        tree_oracles.yaml_tree,
        2,
        tree=True,
        agrees=lambda tree, found: equal(readers.plain(tree or {}), found),
    ),
    Target(
        "configuration of a run",
        model_bases.run_folder,
        readers.run_data,
        _yaml,
        tree_oracles.yaml_tree,
        3,
        tree=True,
        names_file=False,
    ),
    Target("table", model_bases.table, readers.table, _yaml, tree_oracles.yaml_tree, 2, tree=True),
    Target(
        "run",
        model_bases.run_store,
        readers.run_store,
        _json,
        tree_oracles.json_tree,
        2,
        tree=True,
        agrees=lambda tree, found: bool(tree["result"] == found),
    ),
    _stream("cobs", 4),
    _stream("anyskin", 4),
    _stream("flexitac", 3),
    _stream("m1616", 3),
    _stream("paxini", 3),
    _stream("text", 4),
    _stream("lines", 4),
    _stream("robotiq", 4),
    _stream("letter_array", 2),
)


def schedule() -> list[Target]:
    """The targets of case 0, 1, ..., over and over: each as often as its weight."""
    order = [target for target in TARGETS for _ in range(target.weight)]
    Random(0).shuffle(order)
    return order
