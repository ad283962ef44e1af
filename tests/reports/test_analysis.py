import pytest
import torch

pytest.importorskip("lightning", reason="needs the extra 'train'")
pytest.importorskip("matplotlib", reason="needs the extra 'viz'")

import yaml
from fake_configs import SCALED, fake_config, fake_dataset
from listed_outputs import check_listed
from torch.nn.functional import binary_cross_entropy_with_logits, cross_entropy

from torch_geometric_tactile.cli import main
from torch_geometric_tactile.data import StaticData, StaticDataset
from torch_geometric_tactile.nn.models import MTGCN
from torch_geometric_tactile.predictor import Predictor
from torch_geometric_tactile.reports import _analysis
from torch_geometric_tactile.reports._analysis import analyze
from torch_geometric_tactile.sensors import TaxelLayout

pytestmark = pytest.mark.slow

NODE = torch.arange(16)
# Four patches of two digits, on two links of an Allegro hand; a ring of edges in both directions.
LAYOUT = TaxelLayout(
    "two_digits",
    pos=torch.stack([NODE % 4, NODE // 4, 0 * NODE], dim=1) * 0.005,
    link=NODE // 8,
    patch=NODE // 4,
    digit=NODE // 8,
    link_names=("link_1", "link_5"),
    patch_names=("a_1", "a_2", "b_1", "b_2"),
    digit_names=("a", "b"),
)
EDGES = torch.stack([torch.cat([NODE, (NODE + 1) % 16]), torch.cat([(NODE + 1) % 16, NODE])])


class Grasps(StaticDataset):
    """Label 0 stands in the readings of patch b_2, label 1 nowhere."""

    def __init__(self, task="multilabel"):
        self.layout = LAYOUT
        self.task = task
        super().__init__()

    def read(self):
        generator = torch.Generator().manual_seed(0)
        y = torch.randint(2, (80, 2), generator=generator)
        x = torch.randn(80, 16, 3, generator=generator)
        x[:, 12:] += 4 * y[:, :1, None] - 2
        data = StaticData(
            x=x,
            edge_index=EDGES,
            edge_attr=torch.randn(80, 32, 4, generator=generator),
            y=y.float() if self.task == "multilabel" else y[:, 0],
        )
        return data, {"class": ["pressed_hard", "other"]}


def subject(task="multilabel", inputs=("tactile", "edge")):
    torch.manual_seed(0)
    model = MTGCN(16, 2, inputs=inputs, num_edges=32, head_widths=(16,), head_pools=(2,))
    samples = Grasps(task)
    data = samples.data
    optimizer = torch.optim.Adam(model.parameters(), 0.01)
    for _ in range(30):
        given = {name: data[name] for name in model.modalities}
        logits = model(data.x, data.edge_index, **given)
        loss = cross_entropy(logits, data.y)
        if task == "multilabel":
            loss = binary_cross_entropy_with_logits(logits, data.y)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return Predictor.from_dataset(model, samples, task=task), samples


@pytest.fixture
def only_tsne(monkeypatch):
    monkeypatch.setattr(_analysis, "_EMBEDDINGS", (("tsne", 2),))


@pytest.fixture
def no_pictures(only_tsne, monkeypatch):
    monkeypatch.setattr(_analysis, "save_figure", lambda figure, path: None)


@pytest.mark.parametrize("task", ["multilabel", "multiclass"])
def test_page_says_what_was_learnt(only_tsne, tmp_path, task):
    predictor, samples = subject(task)
    before = {name: value.clone() for name, value in predictor.model.state_dict().items()}
    page = analyze(predictor, samples, tmp_path, facts={"Model": "small"}, frames=40)
    text = page.read_text()
    pictures = sorted(path.name for path in tmp_path.glob("*.png"))
    expected = ["attribution", "confusion", "encoder_map", "occlusion", "roc", "tsne_2d"]
    assert pictures == [f"{name}.png" for name in expected]
    assert all(f"]({name})" in text for name in pictures)
    assert "- Model: small" in text
    assert "80 frames; 40 of them" in text
    assert "| between patches | 8 of 32 |" in text
    assert "| between links | 4 of 32 |" in text
    (row,) = [line for line in text.splitlines() if line.startswith("| pressed hard |")]
    if task == "multilabel":  # of two classes, each logit may rest on anything
        assert row.split("|")[3].strip().startswith("b_2 (+")
    after = predictor.model.state_dict()
    assert all(after[name].equal(value) for name, value in before.items())
    assert not predictor.model.training


def test_names_of_others_are_shown_and_are_nothing_else(no_pictures, tmp_path, monkeypatch):
    predictor, samples = subject()
    predictor.class_names = ("a|<b>\n`c`\x1b", "other")
    facts = {"Data": "one\n# two"}
    lines = analyze(predictor, samples, tmp_path, facts=facts, frames=20).read_text().split("\n")
    assert all(map(str.isprintable, lines))
    assert r"- Data: one\n# two" in lines
    assert any(line.startswith(r"| a\|\<b\>\\n\`c\`\\x1b | ") for line in lines)


def test_same_seed_writes_the_same_page(no_pictures, tmp_path):
    predictor, samples = subject()
    pages = [analyze(predictor, samples, tmp_path / str(i), frames=20) for i in range(2)]
    assert pages[0].read_text() == pages[1].read_text()


def test_what_a_model_lacks_is_left_out(no_pictures, tmp_path):
    text = analyze(*subject(inputs=("edge",)), tmp_path, frames=20).read_text()
    assert "this model has no tactile input" in text
    text = analyze(*subject(inputs=("tactile",)), tmp_path, frames=20).read_text()
    assert "this model has no dense edge encoder" in text


def test_bad_input_is_named(tmp_path, capsys):
    predictor, samples = subject()
    with pytest.raises(ValueError, match=r"'frames' must be at least 2 \(got 1\)"):
        analyze(predictor, samples, tmp_path, frames=1)
    predictor.task = "regression"
    with pytest.raises(ValueError, match=r"'predictor' must predict classes or labels"):
        analyze(predictor, samples, tmp_path)
    assert main(["analyze", str(tmp_path / "a.ckpt"), "--out", str(tmp_path)]) == 1
    assert "there is no predictor or checkpoint" in capsys.readouterr().err
    subject()[0].save(tmp_path / "a.predictor")
    assert main(["analyze", str(tmp_path / "a.predictor"), "--out", str(tmp_path)]) == 1
    assert "pass it with '--config'" in capsys.readouterr().err


@pytest.mark.filterwarnings("ignore")
def test_command_reads_the_run_of_a_checkpoint(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    parts = {"test_dataset": fake_dataset(100), "transform": SCALED}
    config = fake_config("GraspGCN", 100, epochs=2, is_logged=True, **parts)
    (tmp_path / "grasp.yaml").write_text(yaml.safe_dump(config))
    assert main(["fit", "--config", "grasp.yaml"]) == 0
    capsys.readouterr()
    checkpoint = "runs/grasp/version_0/checkpoints/last.ckpt"
    assert main(["analyze", checkpoint, "--out", "out", "--frames", "10"]) == 0
    assert "out/analysis.md" in capsys.readouterr().out
    check_listed(["analyze", checkpoint, "--out", tmp_path / "out"], tmp_path / "out")
    text = (tmp_path / "out/analysis.md").read_text()
    assert "`last.ckpt`, after 2 epochs" in text
    model = "GraspGCN(24, 2, in_channels=1, hidden_channels=64, num_fingers=3, fusion='data')"
    assert f"`{model}`" in text
    assert "measured or generated; split by trial, split seed 0" in text
    assert "the layout is not a layout of the Allegro hand" in text

    # The same from a file that needs no checkpoint.
    assert main(["predict", checkpoint, "--save", "grasp.predictor"]) == 0
    command = ["analyze", "grasp.predictor", "--config", "grasp.yaml", "--frames", "10"]
    assert main([*command, "--out", "again"]) == 0
    again = (tmp_path / "again/analysis.md").read_text()
    assert "- Predictor: `grasp.predictor`" in again
    assert again.partition("- Model")[2] == text.partition("- Model")[2]
