r"""Names and options that version 0.3.0 removed. Version 0.4.0 deletes this module."""

from collections.abc import Callable
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
# Each has a row in docs/migration.md.
REPLACEMENTS: dict[str, str] = {
    "experiments.Workers": (
        "give the number of jobs alone, run_plan(plan, out, jobs=2); for a cluster, surround the "
        "call with joblib.parallel_config(backend=...)"
    ),
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

# Files of removed features.
LAST_READER = "version 0.2.1 is the last version that reads it"
ENCODER_KEY = "torch_geometric_tactile.encoder"
ENCODER_CLASSES = ("TaxelEncoder", "TunedEncoder", "EncoderScale")


def removal_message(name: str) -> str | None:
    r"""Returns the error message for a removed name, or :obj:`None` for any other name."""
    replacement = REPLACEMENTS.get(name)
    return None if replacement is None else f"'{name}' was removed in version 0.3.0: {replacement}"


def removed_names(
    package: str, fallback: Callable[[str], Any] | None = None
) -> Callable[[str], Any]:
    r"""Returns a module-level :obj:`__getattr__` that raises :obj:`ImportError` for removed names.

    An :obj:`AttributeError` would not do: ``from package import name`` hides its message.
    """

    def get_attribute(name: str) -> Any:
        message = removal_message(f"{package}.{name}".removeprefix(_PACKAGE))
        if message is not None:
            raise ImportError(message)
        if fallback is not None:
            return fallback(name)
        raise AttributeError(f"module '{package}' has no attribute '{name}'")

    return get_attribute
