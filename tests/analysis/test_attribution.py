import pytest
import torch
from torch.nn import Linear, Module
from torch_geometric.data import Batch, Data
from torch_geometric.explain import Explainer, GNNExplainer

from torch_geometric_tactile.analysis import IntegratedGradients, patch_occlusion, taxel_attribution
from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.nn.models import GraspGCN, TactileFNN, TactileGCN

EDGES = torch.tensor([[0, 1, 2, 3], [1, 2, 3, 0]])
GENERATOR = torch.Generator().manual_seed(0)
X = torch.randn(3, 4, 2, generator=GENERATOR)
JOINT = torch.randn(3, 5, generator=GENERATOR)
SEGMENT = torch.tensor([0, 0, 1, 1])


class Chooser(Module):
    """Looks at taxel 2 for label 0, at the joints for label 1, at all taxels for label 2."""

    modalities = ("joint",)

    def forward(self, x, edge_index, joint):
        x = x.view(-1, 4, 2)
        one = x[:, 2].square().sum(-1)
        return torch.stack([one, joint.sum(-1), x.sum(dim=(1, 2)).tanh()], dim=-1)


def batches():
    samples = [Data(x=X[i], edge_index=EDGES, joint=JOINT[i : i + 1]) for i in range(3)]
    return StaticData(x=X, edge_index=EDGES, joint=JOINT), Batch.from_data_list(samples)


@pytest.mark.parametrize("batch", batches(), ids=["static", "batched"])
def test_a_model_that_reads_one_taxel_is_explained_by_it(batch):
    score = taxel_attribution(Chooser(), batch, 0, per_sample=True)
    expected = torch.zeros(3, 4)
    expected[:, 2] = X[:, 2].square().sum(-1)  # the whole logit, as at the baseline it is zero
    torch.testing.assert_close(score, expected)
    torch.testing.assert_close(taxel_attribution(Chooser(), batch, 0), expected.mean(dim=0))


def test_readings_that_do_not_count_have_no_score():
    assert taxel_attribution(Chooser(), batches()[0], 1).equal(torch.zeros(4))


def test_scores_add_up_to_the_logit():
    static, _ = batches()
    model = Chooser()
    algorithm = IntegratedGradients(num_steps=200, baseline=torch.ones(12, 2))
    score = taxel_attribution(model, static, 2, algorithm=algorithm, per_sample=True)
    at_baseline = model(torch.ones_like(X), EDGES, JOINT)
    expected = (model(X, EDGES, JOINT) - at_baseline)[:, 2]
    torch.testing.assert_close(score.sum(dim=1), expected, atol=1e-4, rtol=0)


def test_each_sample_may_have_its_own_target():
    static, _ = batches()
    score = taxel_attribution(Chooser(), static, torch.tensor([0, 1, 2]), per_sample=True)
    for i in range(3):
        assert score[i].equal(taxel_attribution(Chooser(), static, i, per_sample=True)[i])


def test_static_equals_batched_equals_single():
    static, batch = batches()
    model = GraspGCN(4, in_channels=2, num_fingers=1)
    expected = taxel_attribution(model, static, 1, per_sample=True)
    found = taxel_attribution(model, batch, 1, per_sample=True)
    torch.testing.assert_close(found, expected)
    torch.testing.assert_close(taxel_attribution(model, batch.get_example(2), 1), expected[2])


@pytest.mark.parametrize("training", [True, False])
def test_model_keeps_its_mode_and_gradients(training):
    model = GraspGCN(4, in_channels=2, num_fingers=1, dropout=0.5).train(training)
    static, _ = batches()
    first = taxel_attribution(model, static, 1)
    assert first.equal(taxel_attribution(model, static, 1))  # no dropout
    drop = patch_occlusion(model, static, 1, SEGMENT)
    assert drop.equal(patch_occlusion(model, static, 1, SEGMENT))
    assert all(module.training == training for module in model.modules())
    assert all(parameter.grad is None for parameter in model.parameters())


def test_another_algorithm_of_pyg():
    model = GraspGCN(4, in_channels=2, num_fingers=1)
    score = taxel_attribution(model, batches()[0], 1, algorithm=GNNExplainer(epochs=2))
    assert score.shape == (4,)
    assert score.isfinite().all()


def test_algorithm_in_an_explainer_of_classes():
    model = GraspGCN(4, in_channels=2, num_fingers=1)
    setting = {"mode": "multiclass_classification", "task_level": "graph", "return_type": "raw"}
    explainer = Explainer(
        model, IntegratedGradients(), "phenomenon", setting, node_mask_type="object"
    )
    found = explainer(X[0], EDGES, target=torch.tensor([1])).node_mask
    expected = taxel_attribution(model, Data(x=X[0], edge_index=EDGES), 1)
    torch.testing.assert_close(found.view(-1), expected)
    with pytest.raises(ValueError, match="does not support the given explanation settings"):
        Explainer(model, IntegratedGradients(), "model", setting, edge_mask_type="object")


@pytest.mark.parametrize("batch", batches(), ids=["static", "batched"])
def test_occlusion_by_hand(batch):
    found = patch_occlusion(Chooser(), batch, 0, SEGMENT, per_sample=True)
    expected = torch.zeros(3, 2)
    expected[:, 1] = X[:, 2].square().sum(-1) - X[:, 2].mean(dim=0).square().sum()
    torch.testing.assert_close(found, expected)
    zero = patch_occlusion(Chooser(), batch, 0, SEGMENT, reference=torch.zeros(4, 2))
    torch.testing.assert_close(zero[1], X[:, 2].square().sum(-1).mean())


def test_linear_model_occluded_by_zero_equals_its_attribution():
    class Flat(Module):
        def __init__(self):
            super().__init__()
            self.lin = Linear(8, 3)

        def forward(self, x, edge_index):
            return self.lin(x.view(-1, 8))

    model, (static, _) = Flat(), batches()
    score = taxel_attribution(model, static, 2, per_sample=True)
    drop = patch_occlusion(model, static, 2, SEGMENT, reference=torch.zeros(4, 2), per_sample=True)
    torch.testing.assert_close(score.view(3, 2, 2).sum(dim=-1), drop)


@pytest.mark.parametrize("algorithm", [None, GNNExplainer(epochs=2)])
def test_model_without_a_graph_needs_no_edges(algorithm):
    model = TactileFNN(4, 3, channels={"tactile": 2}, widths=(6,), pools=(2,))
    static = StaticData(x=X)
    for batch in (static, static.to_batch()):
        assert taxel_attribution(model, batch, 0, algorithm=algorithm).abs().sum() > 0
        assert patch_occlusion(model, batch, 0, SEGMENT).abs().sum() > 0
    with pytest.raises(ValueError, match="'batch' must have 'edge_index', which the model needs"):
        taxel_attribution(TactileGCN(4, 3, channels={"tactile": 2}), static, 0)


def test_bad_input_is_named():
    static, _ = batches()
    with pytest.raises(ValueError, match="'batch' must have 'joint', which the model needs"):
        taxel_attribution(Chooser(), StaticData(x=X, edge_index=EDGES), 0)
    with pytest.raises(ValueError, match=r"'target' must be between 0 and 2 \(got 3 to 3\)"):
        taxel_attribution(Chooser(), static, 3)
    with pytest.raises(ValueError, match=r"integers of shape \(3,\) \(got torch.int64 of .*\(2,\)"):
        taxel_attribution(Chooser(), static, torch.tensor([0, 1]))
    with pytest.raises(ValueError, match=r"'target' must be an integer"):
        taxel_attribution(Chooser(), static, torch.tensor([0.0, 1.0, 1.0]))
    with pytest.raises(ValueError, match=r"'batch' must hold samples"):
        taxel_attribution(Chooser(), static.index_select(slice(0, 0)), 0)
    with pytest.raises(ValueError, match=r"'segment' must have shape \(4,\) \(got \(3,\)\)"):
        patch_occlusion(Chooser(), static, 0, SEGMENT[1:])
    with pytest.raises(ValueError, match=r"'reference' must have shape \(4, 2\)"):
        patch_occlusion(Chooser(), static, 0, SEGMENT, reference=torch.zeros(2, 4))
    with pytest.raises(ValueError, match="'reference' must be given for a single sample"):
        patch_occlusion(Chooser(), static.sample(0), 0, SEGMENT)
    with pytest.raises(ValueError, match=r"'num_steps' must be at least 1 \(got 0\)"):
        IntegratedGradients(num_steps=0)
    with pytest.raises(ValueError, match=r"'baseline' must have the shape of 'x', \(12, 2\)"):
        taxel_attribution(Chooser(), static, 0, algorithm=IntegratedGradients(1, torch.zeros(2)))
