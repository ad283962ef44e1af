import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

from torch_geometric_tactile.nn.models import TaxelNet
from torch_geometric_tactile.papers import load_table
from torch_geometric_tactile.papers._taxel_net_without_edges import TaxelNetWithoutEdges
from torch_geometric_tactile.training import classifier_from_config
from torch_geometric_tactile.training._config import config_names, find_config, load_config
from torch_geometric_tactile.training._lightning_cli import resolve_config_names

GCN = [name for name in config_names() if name.startswith("grasp_gcn_")]


def test_names_of_the_models_are_shipped():
    used = {cell.config for cell in load_table("bts3").cells if cell.config is not None}
    others = {"grasp_taxel_net"}
    others |= {f"grasp_time_{model}" for model in ("gcn_df", "lstm", "temporal")}
    others |= {f"grasp_gcn_{finger}" for finger in ("index", "middle", "thumb")}
    assert used | others == set(config_names())
    assert not used & others


def test_taxel_nets_differ_in_their_readings_only():
    raw, common = (load_config(name) for name in ("grasp_taxel_net", "grasp_common_mode"))
    transform = common["data"].pop("transform")["init_args"]["transforms"]
    names = [part["class_path"].rpartition(".")[2] for part in transform]
    assert names == ["CommonMode", "SelectChannels", "ZScore"]
    assert raw["data"].pop("transform")["class_path"].endswith("SessionZScore")
    assert common == raw
    assert raw["model"]["lr_scheduler"]["class_path"].endswith(".CosineAnnealing")
    raw["model"]["model"]["init_args"]["out_channels"] = 2  # that of the data
    assert isinstance(classifier_from_config(raw["model"]).model, TaxelNet)


def test_network_without_edges_differs_in_its_class_only():
    net, without_edges = (load_config(name) for name in ("grasp_common_mode", "grasp_no_edges"))
    assert net["model"]["model"].pop("class_path").endswith(".TaxelNet")
    class_path = without_edges["model"]["model"].pop("class_path")
    assert class_path == f"{TaxelNetWithoutEdges.__module__}.TaxelNetWithoutEdges"
    assert without_edges == net


def test_gcn_sees_the_readings_of_the_taxel_net():
    gcn, net, df = (
        load_config(name) for name in ("grasp_gcn_common_mode", "grasp_common_mode", "grasp_gcn_df")
    )
    assert gcn["data"]["transform"] == net["data"]["transform"]
    gcn["data"]["transform"] = df["data"]["transform"]
    assert gcn["model"]["model"]["init_args"].pop("num_fingers") == 2
    assert gcn == df


def test_lstm_differs_from_the_gcn_in_its_model_only():
    lstm, gcn = (load_config(f"grasp_{name}_common_mode") for name in ("lstm", "gcn"))
    net = lstm["model"].pop("model")
    assert net["class_path"].endswith(".GraspLSTM")
    assert net["init_args"]["num_fingers"] == gcn["model"].pop("model")["init_args"]["num_fingers"]
    for part in ("dataset", "test_dataset"):
        del gcn["data"][part]["init_args"]["pre_transform"]  # it needs no edges
    assert lstm == gcn


@pytest.mark.parametrize("name", GCN)
def test_shipped_configuration_builds_its_model(name):
    model = classifier_from_config(load_config(name)["model"]).model
    expected = {
        "grasp_gcn_common_mode": ("data", None),
        "grasp_gcn_df": ("data", None),
        "grasp_gcn_ff": ("feature", None),
        "grasp_gcn_index": (None, 0),
        "grasp_gcn_middle": (None, 1),
        "grasp_gcn_thumb": (None, 2),
    }[name]
    assert (model.fusion, model.finger) == expected


def test_shipped_configurations_differ_in_their_model_only():
    names = [name for name in GCN if name != "grasp_gcn_common_mode"]
    first, *others = (load_config(name) for name in names)
    for other in others:
        assert other["data"] == first["data"]
        assert other["trainer"] == first["trainer"]
        assert other["model"]["optimizer"] == first["model"]["optimizer"]


def test_file_comes_before_a_shipped_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "grasp_gcn_df").write_text("{}")
    assert find_config("grasp_gcn_df").read_text() == "{}"


def test_unknown_name_lists_the_shipped():
    with pytest.raises(FileNotFoundError, match=r"no file 'nope'.*grasp_gcn_df, grasp_gcn_ff"):
        find_config("nope")


def test_names_on_the_command_line_become_paths():
    args, name = resolve_config_names(["fit", "--config=grasp_gcn_ff", "--model.num_classes", "2"])
    assert name == "grasp_gcn_ff"
    assert args == ["fit", f"--config={find_config('grasp_gcn_ff')}", "--model.num_classes", "2"]
    args, _ = resolve_config_names(["fit", "-c", "grasp_gcn_df"])
    assert args[2] == str(find_config("grasp_gcn_df"))


@pytest.mark.parametrize(
    "config",
    [
        {"model": {"class_path": "torch.nn.Linear", "init_args": {"in_features": 2}}},
        {"model": {"class_path": "torch.nn.Identity"}, "num_classes": [2]},
        {"model": {"class_path": "logging.FileHandler"}},
        {"model": 3},
    ],
)
def test_a_configuration_of_no_module_is_one_kind_of_error(config):
    with pytest.raises(ValueError, match="'config' must describe a TactileModule"):
        classifier_from_config(config)


def test_no_schedule_has_epochs_of_its_own():
    # `--epochs` and `--trainer.max_epochs` would not change them.
    lengths = {"T_max", "T_0", "total_steps", "epochs", "milestones", "step_size", "patience"}
    scheduled = 0
    for name in (*config_names(), "p3_table2/temporal", "p4_tables/taxel_net"):
        scheduler = load_config(name)["model"].get("lr_scheduler")
        if scheduler is not None:
            scheduled += 1
            assert not lengths & (scheduler.get("init_args") or {}).keys(), name
    assert scheduled >= 13
