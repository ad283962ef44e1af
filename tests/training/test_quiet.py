import logging
import warnings

import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

from lightning.pytorch.utilities.rank_zero import rank_zero_warn

from torch_geometric_tactile.training import quiet_lightning

LOGGER = logging.getLogger("lightning.pytorch")


def test_quiet_lightning_silences_lightning_alone(recwarn, caplog):
    level = LOGGER.level
    with quiet_lightning():
        LOGGER.warning("few workers")
        warnings.warn_explicit("few workers", UserWarning, "a.py", 1, module="lightning.pytorch")
        warnings.warn("of a user", UserWarning, stacklevel=1)
    assert LOGGER.level == level
    assert [str(warning.message) for warning in recwarn] == ["of a user"]
    assert not caplog.records
    rank_zero_warn("shown again", stacklevel=1)
    assert len(recwarn) == 2


def test_quiet_lightning_ends_with_an_error():
    level = LOGGER.level
    with pytest.raises(RuntimeError, match="stop"), quiet_lightning():
        raise RuntimeError("stop")
    assert LOGGER.level == level
