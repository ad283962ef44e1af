"""Every function of the package that reads a file, with what it read as plain values."""

import dataclasses
import functools
import logging
from pathlib import Path
from typing import Any

import numpy as np
import torch
from fuzz.laws import equal

from torch_geometric_tactile.data import Recording


def recording(found: Recording) -> Any:
    return {field.name: plain(getattr(found, field.name)) for field in dataclasses.fields(found)}


def plain(value: Any) -> Any:
    if isinstance(value, torch.Tensor):
        return _tensor(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = dataclasses.fields(value)
        return {field.name: plain(getattr(value, field.name)) for field in fields}
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if value is None or isinstance(value, bool | int | float | str | bytes | np.ndarray):
        return value
    return repr(value)


def _tensor(value: torch.Tensor) -> np.ndarray:
    value = value.detach()
    if value.is_sparse or value.is_sparse_csr:
        value = value.to_dense()
    return np.asarray(value.numpy(force=True))


def state(module: torch.nn.Module) -> Any:
    return {"module": repr(module), **plain(dict(module.state_dict()))}


def wide_csv(path: Path) -> Any:
    from torch_geometric_tactile.io._wide_csv import read_wide_csv

    return recording(read_wide_csv(path))


def annotations_csv(path: Path) -> Any:
    from torch_geometric_tactile.io._folder_tables import read_annotations

    return plain(read_annotations(path))


def labels_csv(path: Path) -> Any:
    from torch_geometric_tactile.io._folder_tables import read_labels

    return plain(read_labels(path))


def named_csv(path: Path) -> Any:
    from torch_geometric_tactile.io._named_csv import read_named_csv

    return recording(read_named_csv(path))


def excel_csv(path: Path) -> Any:
    from torch_geometric_tactile.io import read_recording

    options = {"preamble": 1, "decimal": ",", "missing": ["NA", -1], "unit": None}
    return recording(read_recording(path, **options))


GIVEN_NAMES = {"tactile": ("thumb", "index", "palm"), "joint": ("wrist",), "label": "cup"}


def given_names_csv(path: Path) -> Any:
    from torch_geometric_tactile.io._named_csv import read_named_csv

    return recording(read_named_csv(path, **GIVEN_NAMES))


def xela_log(path: Path) -> Any:
    from torch_geometric_tactile.io._xela_log_csv import read_xela_log_csv

    return recording(read_xela_log_csv(path))


def xela_log_forces(path: Path) -> Any:
    from torch_geometric_tactile.io._xela_log_csv import read_xela_log_csv

    return recording(read_xela_log_csv(path, forces=True))


def xela_messages(path: Path) -> Any:
    from torch_geometric_tactile.io._xela_messages import read_xela_messages

    return recording(read_xela_messages(path))


def xela_live(path: Path) -> Any:
    """One message, the same as without the fast path."""
    from torch_geometric_tactile.io import _xela_message as module
    from torch_geometric_tactile.io._xela_message import parse_xela_text

    def said(data: str | bytes) -> Any:
        try:
            return plain(parse_xela_text(data))
        except ValueError as error:
            return f"'{path}': {error}"

    data = path.read_bytes()
    fast = said(data)
    kept = module._parse_regular_words
    module._parse_regular_words = lambda data: None
    try:
        slow = said(data)
    finally:
        module._parse_regular_words = kept
    if not equal(fast, slow):
        raise AssertionError(f"{fast!r:.200} is not {slow!r:.200}")
    if isinstance(fast, str):
        raise ValueError(fast)
    return fast


def biotac_csv(path: Path) -> Any:
    from torch_geometric_tactile.io._biotac_sp_csv import read_biotac_sp_csv

    return plain(tuple(read_biotac_sp_csv(path)))


def dos_csv(path: Path) -> Any:
    from torch_geometric_tactile.io._biotac_sp_csv import read_biotac_sp_dos_csv

    return recording(read_biotac_sp_dos_csv(path))


def slide_csv(path: Path) -> Any:
    from torch_geometric_tactile.io import read_biotac_slide_csv

    return recording(read_biotac_slide_csv(path))


def uskin_pick(path: Path) -> Any:
    from torch_geometric_tactile.io import read_uskin_pick

    return [recording(read_uskin_pick(path.parent, repeats)) for repeats in (True, False)]


def sparsh_skin(path: Path) -> Any:
    """The two files of an episode, one by one."""
    from torch_geometric_tactile.io.sparsh_skin_pickle import _read_joint_states, _read_touch

    return plain(_read_touch(path) if path.name.startswith("touch") else _read_joint_states(path))


def bigs(path: Path) -> Any:
    from torch_geometric_tactile.io import BiGSFormat, read_bigs

    fields = {
        "electrodes": "elec [frame (finger electrode)]",
        "time": "stamp",
        "pressure": "left | middle | right",
        "pac": "pac [(frame step) finger]",
        "robot_joint": "arm [(frame step) joint]",
        "phase": "step",
        "slip": "slipped",
        "success": "done",
        "object": "what",
        "pickup_time": "lift",
    }
    return recording(read_bigs(path, BiGSFormat(fields=fields, time_unit="ms")))


def eflesh_probe(path: Path) -> Any:
    from torch_geometric_tactile.io import read_eflesh_probe

    found = recording(read_eflesh_probe(path.parent))
    return {**found, "meta": {**found["meta"], "trial": ""}}  # the folder of the case


def icub_txt(path: Path) -> Any:
    from torch_geometric_tactile.io._icub_grasp_txt import read_icub_grasp_txt

    return plain(tuple(read_icub_grasp_txt(path)))


def mat_zip(path: Path) -> Any:
    from torch_geometric_tactile.io._pressure_mat_zip import read_pressure_mat_zip

    return plain(list(map(tuple, read_pressure_mat_zip(path, "ii"))))


def mat_zip_hash(path: Path) -> Any:
    from torch_geometric_tactile.io._pressure_mat_zip import pressure_mat_hash

    return pressure_mat_hash(path)


def eflesh_sequence(path: Path) -> Any:
    from torch_geometric_tactile.datasets.eflesh_slip import _read_sequence

    return plain(_read_sequence(str(path)))


def npz(path: Path) -> Any:
    from torch_geometric_tactile.io._recording_npz import read_npz

    return recording(read_npz(path))


def mcap(path: Path) -> Any:
    from torch_geometric_tactile.io import read_mcap

    return recording(read_mcap(path, recover=False))


def recovered_mcap(path: Path) -> Any:
    """What was read of a file that may be damaged, and whether a warning said so."""
    from torch_geometric_tactile.io import read_mcap

    told = _Told()
    log = logging.getLogger("torch_geometric_tactile.io.mcap_reader")
    log.addHandler(told)
    try:
        found = recording(read_mcap(path))
    finally:
        log.removeHandler(told)
    return {**found, "told": bool(told.records)}


class _Told(logging.Handler):
    def __init__(self) -> None:
        super().__init__()
        self.records: list[logging.LogRecord] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.records.append(record)


def samples_npz(path: Path) -> Any:
    from torch_geometric_tactile.datasets import SamplesFile

    dataset = SamplesFile(path, grid="2x3")
    names = (dataset.class_names, dataset.session_names)
    return plain([dataset.layout.to_dict(), dataset.data.to_dict(), names])


def hdf5(path: Path) -> Any:
    from torch_geometric_tactile.io import read_hdf5
    from torch_geometric_tactile.io.recording_hdf5 import read_hdf5_head

    head = read_hdf5_head(path)
    found = read_hdf5(path)
    assert head.label == found.label
    assert head.num_taxels == found.num_taxels
    return recording(found)


def any_recording(path: Path) -> Any:
    from torch_geometric_tactile.io import read_recording

    return recording(read_recording(path))


def matrix(path: Path) -> Any:
    from fuzz.matrix_bases import SIZE

    from torch_geometric_tactile.io._matrix_files import read_matrices

    return read_matrices(path, (32, 32) if path.suffix == ".png" else SIZE)


def mat_variables(path: Path) -> Any:
    from torch_geometric_tactile.io._matrix_mat import read_mat_variables

    return read_mat_variables(path, ["press", "names", "valid"])


def idx(path: Path) -> Any:
    from torch_geometric_tactile.io._idx_file import read_idx

    return read_idx(path)


def calibration(path: Path) -> Any:
    from torch_geometric_tactile.transforms import Calibrate

    return plain(Calibrate.load(path).to_dict())


def layout(path: Path) -> Any:
    from torch_geometric_tactile.sensors import as_layout

    return plain(as_layout(path).to_dict())


def taxel_map(path: Path) -> Any:
    from torch_geometric_tactile.live import TaxelMap

    found = TaxelMap.load(path)
    keys = ("layout", "source", "num_taxels")
    return {"index": found.index.tolist(), **{key: getattr(found, key) for key in keys}}


def chain(path: Path) -> Any:
    from torch_geometric_tactile.sensors import HandKinematics

    return plain(HandKinematics.load(path).to_dict())


def urdf(path: Path) -> Any:
    from torch_geometric_tactile.sensors import HandKinematics

    return plain(HandKinematics.from_urdf(path).to_dict())


def predictor(path: Path) -> Any:
    """What it answers, what it is, and its weights."""
    from torch_geometric_tactile.reports._run_data import open_predictor

    found = open_predictor(path)
    joint = torch.tensor([[0.1, -0.2, 0.3]])
    if found.preparation.num_joints:  # of another hand, if it was mutated
        joint = joint.repeat(1, found.preparation.num_joints)[:, : found.preparation.num_joints]
    frame = torch.arange(8.0).view(1, 4, 2) / 7
    answer = found(frame, joint)
    return {
        "answer": plain(answer),
        "text": repr(found),
        "layout": plain(found.layout.to_dict()),
        "transform": repr(found.transform),
        "contact": found.contact and plain(found.contact.to_dict()),
        "model": state(found.model),
    }


def checkpoint(path: Path) -> Any:
    from torch_geometric_tactile.training import TactileModule

    return state(TactileModule.load_from_checkpoint(path, weights_only=True))


def processed(path: Path) -> Any:
    from torch_geometric_tactile.data._processed_file import read_processed

    found = read_processed(path)
    return {
        "data": plain(found.data.to_dict()),
        "schema": plain(found.data.schema),
        "names": plain(found.names),
        "settings": plain(found.settings),
        "raw_state": plain(found.raw_state),
    }


def config(path: Path) -> Any:
    from torch_geometric_tactile.training._config import load_config
    from torch_geometric_tactile.training._lightning_cli import read_config

    assert isinstance(load_config(str(path)), dict)
    return plain(read_config(path))


def run_data(path: Path) -> Any:
    """The data of the configuration that a received checkpoint has beside it."""
    from torch_geometric_tactile.reports._run_data import load_data

    data = load_data(path.parent / "checkpoints" / "a.ckpt")
    return {name: plain(data.part(name).column("y")) for name in ("train", "val", "test")}


def table(path: Path) -> Any:
    from torch_geometric_tactile.papers import load_table

    return {**plain(load_table(str(path))), "name": ""}


def run_store(path: Path) -> Any:
    from torch_geometric_tactile.experiments._run_store import RunStore

    return plain(RunStore(path.parent).read(experiment()))


@functools.cache
def experiment() -> Any:
    from torch_geometric_tactile.data import Protocol
    from torch_geometric_tactile.experiments._experiment import Experiment
    from torch_geometric_tactile.experiments.source import DataSource

    source = DataSource("torch_geometric_tactile.datasets.FakeTactileDataset", {"num_samples": 8})
    model = {"class_path": "sklearn.linear_model.LogisticRegression"}
    return Experiment("small", source, Protocol("frame"), "by frame", model)
