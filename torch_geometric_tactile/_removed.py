r"""Names and options that version 0.3.0 removed or made private.

Version 0.4.0 deletes this module.
"""

import warnings
from collections.abc import Callable
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

_PACKAGE = "torch_geometric_tactile."

_CLUSTER = (
    "leave it out, and surround the call with joblib.parallel_config(backend=...); "
    "docs/experiments.md has an example with Dask"
)
_ALARMS = (
    "tutorial 8 counts alarms in a few lines of NumPy; studies/early_slip_alarms.py in the "
    "repository has the code"
)
_ALARM_PICTURE = (
    "tutorial 8 draws alarms with matplotlib; studies/early_slip_pictures.py in the repository has "
    "the code"
)
_PRETRAINING = (
    "with few labels, compare 'descriptors_forest' and 'descriptors_svm', which were as accurate"
)
_USER_ESTIMATOR = "write a short estimator around the network (docs/compare.md), or use skorch"

# Maps a removed name (without the package), or a command with its option, to its replacement.
# Each of them has a row in docs/migration.md.
REPLACEMENTS: dict[str, str] = {
    "experiments.Workers": (
        "pass only the number of jobs, run_plan(plan, out, jobs=2); for a cluster, surround the "
        "call with joblib.parallel_config(backend=...)"
    ),
    "experiments.cell_config": "read the attribute 'configuration' of the cell",
    "experiments.quotation": "it is a sentence of advice(comparison)",
    "io.append_hdf5": "write frames with McapWriter, and convert the file with write_hdf5",
    "loader.DistributedBlockSampler": "use BlockSampler in one process; Lightning shares samples",
    "nn.TaxelEncoder": "use TaxelNet",
    "nn.models.TaxelEncoder": "use TaxelNet",
    "papers.LeadTimes": _ALARMS,
    "papers.SlipScores": _ALARMS,
    "papers.SlipSummary": _ALARMS,
    "papers.alarm_threshold": _ALARMS,
    "papers.lead_times": _ALARMS,
    "papers.slip_summary": _ALARMS,
    "predictor.PretrainedEncoder": _PRETRAINING,
    "tactile board --backend": _CLUSTER,
    "tactile board --scheduler": _CLUSTER,
    "tactile compare --backend": _CLUSTER,
    "tactile compare --encoder": _PRETRAINING,
    "tactile compare --scheduler": _CLUSTER,
    "tactile pretrain": _PRETRAINING,
    "tactile table --backend": _CLUSTER,
    "tactile table --scheduler": _CLUSTER,
    "training.NetworkClassifier": _USER_ESTIMATOR,
    "training.NetworkRegressor": _USER_ESTIMATOR,
    "training.TactileClassifier": "use TactileModule, the same class",
    "training.PretrainSettings": _PRETRAINING,
    "training.PretrainStep": _PRETRAINING,
    "training.pretrain": _PRETRAINING,
    "visualization.AlarmCurves": _ALARM_PICTURE,
    "visualization.plot_early_slip": _ALARM_PICTURE,
}

# Names that are no longer exported, by their module.
_PRIVATE_NAMES = {
    "analysis.encoder_map": "encoder_blocks",
    "baselines._features": "FEATURE_NAMES statistical_features",
    "baselines._signal_features": "SignalFeatures",
    "data._image_data": "ImageData StaticImages image_of",
    "data._static_rule": "StaticRule",
    "datasets._root": "default_root",
    "experiments.differences": "run_difference",
    "experiments.tables": "table_of",
    "io._biotac_sp_csv": "GraspTable read_biotac_sp_csv read_biotac_sp_dos_csv",
    "io._icub_grasp_txt": "ICubGraspFrames read_icub_grasp_txt",
    "io._idx_file": "read_idx",
    "io._matrix_files": "read_matrices read_matrix_csv read_matrix_npy read_matrix_png",
    "io._matrix_mat": "read_mat_variables read_matrix_mat",
    "io._named_csv": "read_named_csv",
    "io._pressure_mat_zip": "MatFile pressure_mat_hash read_pressure_mat_zip",
    "io._recording_npz": "read_npz write_npz",
    "io._wide_csv": "read_wide_csv write_wide_csv",
    "io._xela_log_csv": "read_xela_log_csv",
    "io._xela_message": "XelaFrame format_xela_message parse_xela_message parse_xela_text",
    "io._xela_messages": "read_xela_messages write_xela_messages",
    "io.recording_files": "recording_format",
    "io.recording_hdf5": "read_hdf5_head",
    "live._clock_map": "ClockMap",
    "live._outage": "Outage",
    "live._serial_port": "SerialPort list_ports",
    "live.health": "HealthMeter",
    "live.rest": "RestFrames",
    "live.taxel_map": "TaxelOrder",
    "predictor._classes": "transform_classes",
    "predictor._content": "build_model checkpoint_entry is_checkpoint model_entry",
    "sensors._checks": "check_edges check_segment",
    "sensors._taxel_clusters": "TaxelClusters taxel_clusters",
    "sim._bigs_physics": "BIGS_PHASES BigsPhysics BigsSimulator",
    "sim._bigs_plan": "BigsGrasp draw_grasp",
    "sim._bigs_slip": "slip_onset",
    "sim._biotac_grasp": "SimulatedGrasps simulate_grasps",
    "sim._grasp": "GraspPlan GraspResult GraspSimulator PHASES plan_grasp",
    "sim._object_sets": "OBJECT_SETS object_set",
    "sim._squeeze": "SQUEEZE_PHASES SqueezePlan plan_squeeze",
    "sim.hand_model": "stock_bodies",
    "sim.simulate": "grasp_recordings",
    "sim.simulate_bigs": "BIGS_GRASPS",
    "sim.simulate_letters": "LETTER_PRESSES num_letter_files",
    "training._checkpoint": "AtomicCheckpointIO",
    "training._config": "config_names find_config load_config",
    "training._sizes": "DataSizes fill_sizes",
    "transforms._static_transform": "static_transform",
    "transforms.fitting": "fitted_parts",
    "visualization._training_history": "LearningCurves plot_training",
    "visualization.layout": "layout_plane",
}

# By a name below the package, the module that has it now.
PRIVATE_NAMES: dict[str, str] = {
    f"{module.partition('.')[0]}.{name}": f"{_PACKAGE}{module}"
    for module, names in _PRIVATE_NAMES.items()
    for name in names.split()
}

# Modules by the names that they had until version 0.2.
MOVED_MODULES = {
    module.replace("._", "."): module for module in {*PRIVATE_NAMES.values()} if "._" in module
}
# Configurations beside checkpoints name this module.
MOVED_MODULES[f"{_PACKAGE}papers._grasp_twin"] = f"{_PACKAGE}papers._taxel_net_without_edges"

# Files of removed features.
LAST_READER = "version 0.2.1 is the last version that reads it"
ENCODER_KEY = "torch_geometric_tactile.encoder"
ENCODER_CLASSES = ("TaxelEncoder", "TunedEncoder", "EncoderScale")


def removal_message(name: str) -> str | None:
    r"""Returns the error message for a removed or private name, or :obj:`None` for other names."""
    if name in REPLACEMENTS:
        return f"'{name}' was removed in version 0.3.0: {REPLACEMENTS[name]}"
    if name in PRIVATE_NAMES:
        import_line = f"from {PRIVATE_NAMES[name]} import {name.rpartition('.')[2]}"
        return f"'{name}' is private since version 0.3.0 and may change: {import_line}"
    return None


def removed_names(
    package: str, fallback: Callable[[str], Any] | None = None
) -> Callable[[str], Any]:
    r"""Returns a module-level :obj:`__getattr__` whose error names the replacement of a removed
    name.

    The error is an :obj:`AttributeError`, as expected by :func:`hasattr`, :mod:`pickle` and command
    lines that are generated from signatures. ``from package import name`` hides its message: see
    :class:`RemovedNames`.
    """

    def get_attribute(name: str) -> Any:
        message = removal_message(f"{package}.{name}".removeprefix(_PACKAGE))
        if message is None and fallback is not None:
            return fallback(name)
        raise AttributeError(message or f"module '{package}' has no attribute '{name}'")

    return get_attribute


class RemovedNames(MetaPathFinder, Loader):
    r"""An importer that finds moved modules by their earlier names, and explains removed names.

    ``from package import name`` looks for a module ``package.name`` if the package has no such
    attribute, and therefore calls this importer.
    """

    def find_spec(self, fullname: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        r"""Returns the specification of a moved module.

        Raises:
            ImportError: For a removed or private name.
        """
        if message := removal_message(fullname.removeprefix(_PACKAGE)):
            raise ImportError(message)
        return ModuleSpec(fullname, self) if fullname in MOVED_MODULES else None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        r"""Returns the module with its current name."""
        present = MOVED_MODULES[spec.name]
        warnings.warn(
            f"'{spec.name}' is private since version 0.3.0: import '{present}'; version 0.4.0 no "
            "longer accepts the earlier name",
            DeprecationWarning,
            stacklevel=2,
        )
        module = import_module(present)
        spec.loader_state = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        r"""Restores the specification that the import system replaced. The module has run."""
        assert module.__spec__ is not None
        module.__spec__ = module.__spec__.loader_state
