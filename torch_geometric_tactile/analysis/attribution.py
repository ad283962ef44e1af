r"""Attribution of predictions to taxels and patches."""

from typing import Any

import torch
from torch import Tensor
from torch.nn import Module
from torch_geometric.data import Batch, Data
from torch_geometric.explain import Explainer, ExplainerAlgorithm, Explanation
from torch_geometric.explain.config import MaskType, ModelMode, ModelReturnType

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.nn.conv._explainable_propagate import restore_propagate
from torch_geometric_tactile.nn.models._calls import (
    batch_vector,
    input_names,
    needs_edges,
    takes_batch,
)


class IntegratedGradients(ExplainerAlgorithm):
    r"""The integrated gradients explainer from the `"Axiomatic Attribution for Deep Networks"
    <https://arxiv.org/abs/1703.01365>`_ paper. It is an algorithm for
    :class:`torch_geometric.explain.Explainer` and needs only gradients.

    .. math::
        a = (\mathbf{x} - \mathbf{b}) \odot \int_0^1
        \nabla f(\mathbf{b} + t (\mathbf{x} - \mathbf{b})) \, \mathrm{d}t

    If the integral is exact, the scores sum to :math:`f(\mathbf{x}) - f(\mathbf{b})`. Edges and all
    other inputs are kept constant. The algorithm explains raw outputs and log-probabilities. The
    :obj:`node_mask_type` may be :obj:`"attributes"` or :obj:`"object"`. Edge masks are not
    supported.

    Args:
        num_steps (int): Number of points at which the gradient is computed (midpoint rule).
        baseline (torch.Tensor, optional): The reference input :math:`\mathbf{b}`, with the shape of
            :obj:`x`. Defaults to zero, which is the mean reading after
            :class:`~torch_geometric_tactile.transforms.ZScore`.

    Raises:
        ValueError: If :obj:`num_steps` is below one, or :obj:`baseline` does not have the shape of
            :obj:`x`.

    Examples:
        >>> from torch_geometric.explain import Explainer
        >>> from torch_geometric_tactile.nn import TaxelNet
        >>> from torch_geometric_tactile.sensors import grid
        >>> layout = grid(2, 2, pitch=0.004)
        >>> explainer = Explainer(
        ...     TaxelNet(layout, 2).eval(),
        ...     IntegratedGradients(num_steps=8),
        ...     explanation_type="model",
        ...     node_mask_type="attributes",
        ...     model_config={
        ...         "mode": "multiclass_classification",
        ...         "task_level": "graph",
        ...         "return_type": "raw",
        ...     },
        ... )
        >>> explanation = explainer(torch.randn(4, 3), torch.tensor([[0, 1], [1, 0]]))
        >>> explanation.node_mask.shape
        torch.Size([4, 3])
    """

    def __init__(self, num_steps: int = 16, baseline: Tensor | None = None) -> None:
        super().__init__()
        need(num_steps >= 1, "'num_steps' must be at least 1", num_steps)
        self.num_steps = num_steps
        self.baseline = baseline

    def forward(
        self,
        model: Module,
        x: Tensor,
        edge_index: Tensor,
        *,
        target: Tensor,
        index: int | Tensor | None = None,
        **kwargs: Any,
    ) -> Explanation:
        r"""Explains the outputs of a model.

        Args:
            model (torch.nn.Module): The model.
            x (torch.Tensor): Node features.
            edge_index (torch.Tensor): Edges.
            target (torch.Tensor): The classes to explain, for a multiclass model.
            index (int or torch.Tensor, optional): Rows of the output to explain.
            **kwargs: Further arguments of the model.

        Shapes:
            - **x, node_mask:** :math:`(N, F)`; the mask is :math:`(N, 1)` for the type
              :obj:`"object"`

        Raises:
            ValueError: If the baseline does not have the shape of :obj:`x`.
        """
        baseline = torch.zeros_like(x) if self.baseline is None else self.baseline.to(x)
        if baseline.shape != x.shape:
            raise ValueError(
                f"'baseline' must have the shape of 'x', {tuple(x.shape)} "
                f"(got {tuple(baseline.shape)})"
            )
        difference = (x - baseline).detach()
        total = torch.zeros_like(difference)
        for step in range(self.num_steps):
            fraction = (step + 0.5) / self.num_steps
            point = (baseline + fraction * difference).detach().requires_grad_()
            with torch.enable_grad():
                out = self._explained_sum(model(point, edge_index, **kwargs), target, index)
            if out.requires_grad:  # a model may ignore the readings
                (gradient,) = torch.autograd.grad(out, point, allow_unused=True)
                total += torch.zeros_like(point) if gradient is None else gradient
        score = difference * total / self.num_steps
        if self.explainer_config.node_mask_type == MaskType.object:
            score = score.sum(dim=-1, keepdim=True)
        return Explanation(node_mask=score)

    def _explained_sum(self, out: Tensor, target: Tensor, index: int | Tensor | None) -> Tensor:
        # Returns the sum over samples. Samples do not interact, so the gradient of the sum holds
        # the gradient of each sample.
        if self.model_config.mode == ModelMode.multiclass_classification:
            out = out.gather(1, target.view(-1, 1))
        return out.sum() if index is None else out[index].sum()

    def supports(self) -> bool:
        r"""Returns whether the settings of the explainer are supported."""
        masks, model = self.explainer_config, self.model_config
        return (
            masks.edge_mask_type is None
            and masks.node_mask_type in (MaskType.attributes, MaskType.object)
            and model.mode in (ModelMode.regression, ModelMode.multiclass_classification)
            and model.return_type in (ModelReturnType.raw, ModelReturnType.log_probs)
        )


def taxel_attribution(
    model: Module,
    batch: Data,
    target: int | Tensor,
    *,
    algorithm: ExplainerAlgorithm | None = None,
    per_sample: bool = False,
) -> Tensor:
    r"""Returns the contribution of each taxel's reading to the logit of a class or label, computed
    with :class:`torch_geometric.explain.Explainer`.

    With :class:`IntegratedGradients`, the scores of a sample sum to its logit minus the logit of
    the baseline. Only the readings :obj:`x` are explained. Other inputs of the model, such as joint
    angles, are kept constant. Scores are in units of the logit and are not scaled.

    Args:
        model (torch.nn.Module): The model. It is called as :obj:`model(x, edge_index, ...)` with
            the attributes of the batch in :obj:`model.modalities`, and returns logits
            :math:`(B, C)`.
        batch (Data): Samples as :class:`~torch_geometric_tactile.data.StaticData`, one
            :class:`~torch_geometric.data.Data` or PyG's :class:`~torch_geometric.data.Batch`.
        target (int or torch.Tensor): The class or label to explain, for all samples or for each
            sample :math:`(B,)`.
        algorithm (ExplainerAlgorithm, optional): An algorithm from PyG that masks node features,
            such as :class:`~torch_geometric.explain.GNNExplainer` or
            :class:`~torch_geometric.explain.CaptumExplainer`. Defaults to
            :class:`IntegratedGradients`.
        per_sample (bool): Whether to return the scores of each sample instead of their mean.

    Shapes:
        - **output:** :math:`(N,)`, or :math:`(B, N)` with :obj:`per_sample`

    Raises:
        ValueError: If :obj:`batch` lacks an input of the model or is empty, or if :obj:`target` has
            the wrong shape or an unknown class.

    Examples:
        >>> from torch_geometric_tactile.nn import TaxelNet
        >>> from torch_geometric_tactile.sensors import grid
        >>> layout = grid(2, 2, pitch=0.004)
        >>> data = Data(x=torch.randn(4, 3), edge_index=torch.tensor([[0, 1], [1, 0]]))
        >>> taxel_attribution(TaxelNet(layout, 2).eval(), data, target=1).shape
        torch.Size([4])
    """
    samples = _Samples(model, batch, target)
    restore_propagate(model)
    explainer = Explainer(
        samples,
        IntegratedGradients() if algorithm is None else algorithm,
        explanation_type="model",
        node_mask_type="attributes",
        model_config={"mode": "regression", "task_level": "graph", "return_type": "raw"},
    )
    x = samples.x.detach()
    # PyG's masks have two dimensions, so the samples are joined in the first dimension.
    mask = explainer(x.reshape(-1, x.size(-1)), samples.edge_index).node_mask
    score = mask.detach().view(samples.num_samples, samples.num_nodes, -1).sum(dim=-1)
    return score if per_sample else score.mean(dim=0)


def patch_occlusion(
    model: Module,
    batch: Data,
    target: int | Tensor,
    segment: Tensor,
    *,
    reference: Tensor | None = None,
    per_sample: bool = False,
) -> Tensor:
    r"""Returns by how much the logit of a class or label decreases when the readings of a patch are
    replaced by their mean. Use it to check :func:`taxel_attribution` without gradients.

    If other patches hold the same information, the score of a patch is zero, since the other
    patches remain. A large patch of pure noise may have a nonzero score, since a mean is smoother
    than any reading.

    Args:
        model (torch.nn.Module): As in :func:`taxel_attribution`.
        batch (Data): As in :func:`taxel_attribution`.
        target (int or torch.Tensor): The class or label, for all samples or for each sample
            :math:`(B,)`.
        segment (torch.Tensor): Patch of each taxel.
        reference (torch.Tensor, optional): Replacement for the readings. Defaults to the mean
            reading over the samples of the batch.
        per_sample (bool): Whether to return the decreases of each sample instead of their mean.

    Shapes:
        - **segment:** :math:`(N,)`
        - **reference:** :math:`(N, F)`
        - **output:** decrease for each of the :math:`S` patches :math:`(S,)`, or :math:`(B, S)`
          with :obj:`per_sample`

    Raises:
        ValueError: If :obj:`segment` or :obj:`reference` has the wrong shape, :obj:`reference` is
            missing for a single sample, or :func:`taxel_attribution` would reject an argument.

    Examples:
        >>> from torch_geometric_tactile.data import StaticData
        >>> from torch_geometric_tactile.nn import TaxelNet
        >>> from torch_geometric_tactile.sensors import grid
        >>> layout = grid(2, 2, pitch=0.004)
        >>> batch = StaticData(x=torch.randn(5, 4, 3), edge_index=torch.tensor([[0, 1], [1, 0]]))
        >>> patches = torch.tensor([0, 0, 1, 1])
        >>> patch_occlusion(TaxelNet(layout, 2).eval(), batch, target=1, segment=patches).shape
        torch.Size([2])
    """
    samples = _Samples(model, batch, target)
    x = samples.x.detach()
    shape = (samples.num_samples, samples.num_nodes, x.size(-1))
    if segment.shape != shape[1:2]:
        raise ValueError(f"'segment' must have shape ({shape[1]},) (got {tuple(segment.shape)})")
    if reference is None:
        need(
            shape[0] != 1,
            "'reference' must be given for a single sample, since its mean is the sample itself",
        )
        reference = x.view(shape).mean(dim=0)
    if reference.shape != shape[1:]:
        raise ValueError(f"'reference' must have shape {shape[1:]} (got {tuple(reference.shape)})")
    segment = segment.to(x.device)
    training = samples.training
    samples.eval()
    with torch.no_grad():
        logit = samples(x, samples.edge_index)
        drops = []
        for i in range(int(segment.max()) + 1):
            occluded = torch.where((segment == i).view(-1, 1), reference.to(x), x.view(shape))
            drops.append(logit - samples(occluded, samples.edge_index))
    samples.train(training)
    drop = torch.stack(drops, dim=1)
    return drop if per_sample else drop.mean(dim=0)


class _Samples(Module):
    # The model for the samples of one batch, as a function of readings in any shape. It returns the
    # logit of each sample's target.
    def __init__(self, model: Module, batch: Data, target: int | Tensor) -> None:
        super().__init__()
        names = input_names(model)
        edges = ("edge_index",) if needs_edges(model) else ()
        if takes_batch(model) and isinstance(batch, StaticData):
            batch = batch.to_batch()
        missing = [name for name in ("x", *edges, *names) if batch.get(name) is None]
        if missing:
            raise ValueError(f"'batch' must have '{missing[0]}', which the model needs (got none)")
        self.model = model
        # Otherwise, the explainer would leave the model in training mode.
        self.training = model.training
        self.x = batch.x
        # PyG's explainers require edges, even for a model without a graph.
        self.has_edges = batch.edge_index is not None
        no_edges = torch.zeros(2, 0, dtype=torch.long, device=batch.x.device)
        self.edge_index: Tensor = batch.edge_index if self.has_edges else no_edges
        if isinstance(batch, StaticData):
            self.num_samples = batch.num_samples
        else:
            self.num_samples = batch.num_graphs if isinstance(batch, Batch) else 1
        need(
            batch.x.numel() != 0,
            f"'batch' must hold samples (got 'x' of shape {tuple(batch.x.shape)})",
        )
        self.num_nodes = batch.x.numel() // batch.x.size(-1) // self.num_samples
        self.inputs = {name: batch[name] for name in names}
        if takes_batch(model):
            self.inputs["batch"] = batch_vector(batch)
        target = torch.as_tensor(target, device=batch.x.device)
        if target.dtype != torch.long or target.shape not in ((), (self.num_samples,)):
            raise ValueError(
                f"'target' must be an integer, or integers of shape ({self.num_samples},) "
                f"(got {target.dtype} of shape {tuple(target.shape)})"
            )
        self.target = target.expand(self.num_samples)

    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        edges = edge_index if self.has_edges else None
        logits = self.model(x.view(self.x.shape), edges, **self.inputs)
        if int(self.target.min()) < 0 or int(self.target.max()) >= logits.size(-1):
            raise ValueError(
                f"'target' must be between 0 and {logits.size(-1) - 1} "
                f"(got {int(self.target.min())} to {int(self.target.max())})"
            )
        target_logits: Tensor = logits.gather(1, self.target.view(-1, 1)).view(-1)
        return target_logits
