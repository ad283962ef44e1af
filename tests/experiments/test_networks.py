import pytest

pytest.importorskip("lightning")

from torch_geometric_tactile.experiments._networks import L, warm_up


def test_ctrl_c_while_a_process_warms_up_is_an_interrupt(monkeypatch):
    # Lightning ends the process with status 1, and the command would not say what is kept.
    def stopped(*arguments, **options):
        raise SystemExit(1)

    monkeypatch.setattr(L.Trainer, "fit", stopped)
    warm_up.cache_clear()
    with pytest.raises(KeyboardInterrupt):
        warm_up("cpu")
    warm_up.cache_clear()
