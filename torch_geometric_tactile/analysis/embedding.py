r"""Node features in two or three dimensions."""

from typing import Literal

import torch
from sklearn.manifold import TSNE
from torch import Tensor

from torch_geometric_tactile._checks import need

_MIN_NODES = 8  # with fewer, neither method has neighbourhoods to preserve


def node_matrix(features: Tensor, frames: Literal["joined", "mean"] = "joined") -> Tensor:
    r"""Returns one row for each node that describes it by its features in all frames.

    Each channel is centred and divided by its standard deviation over all nodes and frames, so that
    none counts more for its unit; a channel that never changes becomes zero. Frames are not scaled
    one by one: one with a weak touch stays weak.

    Args:
        features (torch.Tensor): Node features of some frames, or of one.
        frames (str): :obj:`"joined"` puts the features in all frames side by side, so that nodes
            are near each other if they respond alike frame by frame. :obj:`"mean"` takes the mean
            over the frames, which keeps the resting response and hides what touch changes.

    Shapes:
        - **features:** :math:`(B, N, C)` or :math:`(N, C)`
        - **output:** :math:`(N, B \cdot C)` or, of the means, :math:`(N, C)`

    Raises:
        ValueError: If :obj:`features` has another shape, no frame, or a number that is not finite,
            or :obj:`frames` is unknown.

    Examples:
        >>> node_matrix(torch.tensor([[[0.0], [2.0]], [[1.0], [1.0]]]))
        tensor([[-1.4142,  0.0000],
                [ 1.4142,  0.0000]])
    """
    features = features.detach().cpu().float()
    features = features.unsqueeze(0) if features.dim() == 2 else features
    if features.dim() != 3 or features.numel() == 0:
        raise ValueError(
            "'features' must have shape (num_frames, num_nodes, channels) or (num_nodes, "
            f"channels), none of them 0 (got {tuple(features.shape)})"
        )
    if not features.isfinite().all():
        raise ValueError("'features' must hold finite numbers only (got NaN or infinity)")
    need(frames in ("joined", "mean"), f"'frames' must be 'joined' or 'mean' (got '{frames}')")
    if frames == "mean":
        features = features.mean(dim=0, keepdim=True)
    mean = features.mean(dim=(0, 1))
    sd = features.std(dim=(0, 1), correction=0)
    # Rounding gives a constant channel a deviation too.
    constant = sd <= 1e-6 * features.abs().amax(dim=(0, 1))
    scaled = torch.where(constant, 0.0, (features - mean) / sd.masked_fill(constant, 1.0))
    return scaled.transpose(0, 1).flatten(1)


def embed_nodes(
    features: Tensor,
    method: Literal["tsne", "umap"] = "tsne",
    num_components: int = 2,
    seed: int = 0,
    frames: Literal["joined", "mean"] = "joined",
    num_neighbors: int | None = None,
) -> Tensor:
    r"""Embeds nodes with similar features next to each other: t-SNE as in fig. 8 of the "Tactile
    Object Property Recognition using Geometrical Graph Edge Features and Multi-Thread Graph
    Convolutional Network" paper, UMAP as in fig. 5 of the "Multifingered Object Recognition with
    Tactile Sensors and Graph Convolutional Networks using Topological Graph Segmentation" paper.

    The papers do not say how they join frames or scale features; here :func:`node_matrix` does. The
    same input and seed give the same places on one machine. Sizes and distances of clusters mean
    little with either method: :func:`segment_clustering` measures in the space of the features.

    Args:
        features (torch.Tensor): Node features of some frames, or of one, such as
            :obj:`model.node_features(...)`.
        method (str): :obj:`"tsne"` (scikit-learn) or :obj:`"umap"` (umap-learn).
        num_components (int): Number of dimensions, 2 or 3.
        seed (int): Seed of the method.
        frames (str): How the features of several frames are joined; see :func:`node_matrix`.
        num_neighbors (int, optional): How many nodes make a neighbourhood: the perplexity of t-SNE
            (30 if left out), the neighbours of UMAP (15 if left out). Fewer if there are
            few nodes.

    Shapes:
        - **features:** :math:`(B, N, C)` or :math:`(N, C)`
        - **output:** :math:`(N, 2)` or :math:`(N, 3)`

    Raises:
        ImportError: If :obj:`method` is :obj:`"umap"` and umap-learn is missing.
        ValueError: If :obj:`method` or :obj:`num_components` is unknown, there are fewer than 8
            nodes, :obj:`num_neighbors` is below 2, or as :func:`node_matrix`.

    Examples:
        >>> embed_nodes(torch.randn(8, 30, 4), num_components=2).shape
        torch.Size([30, 2])
    """
    need(method in ("tsne", "umap"), f"'method' must be 'tsne' or 'umap' (got '{method}')")
    need(num_components in (2, 3), "'num_components' must be 2 or 3", num_components)
    if num_neighbors is not None and num_neighbors < 2:
        raise ValueError(f"'num_neighbors' must be at least 2 (got {num_neighbors})")
    rows = node_matrix(features, frames).numpy()
    num_nodes = len(rows)
    need(num_nodes >= _MIN_NODES, f"'features' must be of at least {_MIN_NODES} nodes", num_nodes)
    if method == "tsne":
        perplexity = min(num_neighbors or 30, (num_nodes - 1) / 3)
        reducer = TSNE(num_components, perplexity=perplexity, init="pca", random_state=seed)
    else:
        from umap import UMAP  # slow to import: numba compiles

        reducer = UMAP(
            n_components=num_components,
            n_neighbors=min(num_neighbors or 15, num_nodes - 1),
            random_state=seed,
            n_jobs=1,  # more would not be reproducible
        )
    # numba, below UMAP, sets the threads of OpenMP, and so those of PyTorch, to one for each core.
    threads = torch.get_num_threads()
    try:
        return torch.from_numpy(reducer.fit_transform(rows)).float()
    finally:
        torch.set_num_threads(threads)
