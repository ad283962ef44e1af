r"""Embedding of node features in two or three dimensions."""

from typing import Literal

import torch
from sklearn.manifold import TSNE
from torch import Tensor

from torch_geometric_tactile._checks import need

_MIN_NODES = 8  # with fewer nodes, there are no neighbourhoods to preserve


def node_matrix(features: Tensor, frames: Literal["joined", "mean"] = "joined") -> Tensor:
    r"""Returns a matrix with one row for each node. A row holds the scaled features of the node in
    all frames.

    Each channel is centred and divided by its standard deviation over all nodes and frames, so that
    its unit does not matter. A constant channel becomes zero. Frames are not scaled separately, so
    that weak touches stay weak.

    Args:
        features (torch.Tensor): Node features of several frames or of one frame.
        frames (str): :obj:`"joined"` concatenates the features of all frames, so that nodes with
            similar responses in each frame are near each other. :obj:`"mean"` averages over the
            frames, which preserves the response at rest but hides changes caused by touch.

    Shapes:
        - **features:** :math:`(B, N, C)` or :math:`(N, C)`
        - **output:** :math:`(N, B \cdot C)`, or :math:`(N, C)` for :obj:`"mean"`

    Raises:
        ValueError: If :obj:`features` has the wrong shape, no frame or a number that is not finite,
            or if :obj:`frames` is unknown.

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
            f"channels), and no size may be 0 (got {tuple(features.shape)})"
        )
    if not features.isfinite().all():
        raise ValueError("'features' must hold finite numbers only (got NaN or infinity)")
    need(frames in ("joined", "mean"), f"'frames' must be 'joined' or 'mean' (got '{frames}')")
    if frames == "mean":
        features = features.mean(dim=0, keepdim=True)
    mean = features.mean(dim=(0, 1))
    sd = features.std(dim=(0, 1), correction=0)
    # Due to rounding errors, a constant channel has a small deviation.
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
    r"""Embeds nodes in two or three dimensions, so that nodes with similar features are near each
    other. The method is t-SNE, as in fig. 8 of the "Tactile Object Property Recognition using
    Geometrical Graph Edge Features and Multi-Thread Graph Convolutional Network" paper, or UMAP as
    in fig. 5 of the "Multifingered Object Recognition with Tactile Sensors and Graph Convolutional
    Networks using Topological Graph Segmentation" paper.

    The papers do not describe how frames are combined and features are scaled. This function uses
    :func:`node_matrix` for both. On the same machine, the same input and seed yield the same
    embedding. With either method, sizes of clusters and distances between them are not meaningful.
    Use :func:`segment_clustering` to measure clusters in feature space.

    Args:
        features (torch.Tensor): Node features of several frames or of one frame, such as
            :obj:`model.node_features(...)`.
        method (str): :obj:`"tsne"` (scikit-learn) or :obj:`"umap"` (umap-learn).
        num_components (int): Number of dimensions (2 or 3).
        seed (int): Seed for the method.
        frames (str): How to combine the frames; see :func:`node_matrix`.
        num_neighbors (int, optional): Number of nodes in a neighbourhood. This is the perplexity of
            t-SNE (30 by default) or the number of neighbours in UMAP (15 by default). It is reduced
            if there are fewer nodes.

    Shapes:
        - **features:** :math:`(B, N, C)` or :math:`(N, C)`
        - **output:** :math:`(N, 2)` or :math:`(N, 3)`

    Raises:
        ImportError: If :obj:`method` is :obj:`"umap"` and umap-learn is missing.
        ValueError: If :obj:`method` or :obj:`num_components` is unknown, there are fewer than 8
            nodes, :obj:`num_neighbors` is below 2, or :func:`node_matrix` would reject an argument.

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
    need(num_nodes >= _MIN_NODES, f"'features' must have at least {_MIN_NODES} nodes", num_nodes)
    if method == "tsne":
        perplexity = min(num_neighbors or 30, (num_nodes - 1) / 3)
        reducer = TSNE(num_components, perplexity=perplexity, init="pca", random_state=seed)
    else:
        from umap import UMAP  # imported here, since numba compiles it on import

        reducer = UMAP(
            n_components=num_components,
            n_neighbors=min(num_neighbors or 15, num_nodes - 1),
            random_state=seed,
            n_jobs=1,  # multiple jobs are not reproducible
        )
    # Numba, which UMAP uses, sets the number of OpenMP threads to the number of cores. This also
    # changes the number of threads in PyTorch.
    num_threads = torch.get_num_threads()
    try:
        return torch.from_numpy(reducer.fit_transform(rows)).float()
    finally:
        torch.set_num_threads(num_threads)
