r"""A convolutional network with bilinear features for pressure images."""

from typing import Literal, Optional, Union, get_args

import torch
from torch import Tensor
from torch.nn import BatchNorm2d, Conv2d, Linear
from torch.nn import functional as F
from torch.nn.init import xavier_uniform_, zeros_
from torch_geometric.typing import OptTensor

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.nn._sizes import check_sizes
from torch_geometric_tactile.nn.conv._plain import is_hooked
from torch_geometric_tactile.nn.models._base_model import BaseModel
from torch_geometric_tactile.nn.models._taxel_image import TaxelImage
from torch_geometric_tactile.nn.models._taxels import load_layout, stacked_readings
from torch_geometric_tactile.nn.pool.bilinear_feature import BilinearFeature
from torch_geometric_tactile.sensors import TaxelLayout, letter_array

_Fusion = Literal["C3", "bilinear(C1)+C3", "C1+C3", "bilinear(C2)+C3", "C2+C3"]
_NUM_STRIPS = 7  # strips of the products in an export; more strips make slicing slower
_FUSIONS: tuple[str, ...] = get_args(_Fusion)
_DEFAULT_FUSION: _Fusion = "bilinear(C1)+C3"
MIN_MAP_SIZE = 20  # leaves an input of 3 x 3 cells for C3


class BMFCNN(BaseModel):
    r"""The BMF-CNN from the "A Novel Bilinear Feature and Multi-Layer Fused Convolutional Neural
    Network for Tactile Shape Recognition" paper (:doc:`P5 </papers>`), which recognises letters
    pressed onto a sensor array. It has three convolutions. A fully connected layer takes the
    features of the last convolution and the :class:`~torch_geometric_tactile.nn.BilinearFeature` of
    the first.

    For images of 32 x 32 pixels, the layers (without padding) are:

    * C1: 5 x 5 filters, output 28 x 28 x 16, batch normalisation, ReLU;
    * max pooling over 2 x 2 cells;
    * C2: 3 x 3 filters, output 12 x 12 x 32, ReLU;
    * max pooling over 2 x 2 cells;
    * C3: 3 x 3 filters, output 4 x 4 x 64 (1024 features), ReLU;
    * F-C1: fully connected, 120 outputs, ReLU;
    * F-C2: fully connected, 26 outputs.

    The bilinear feature of C1 before pooling has 28 x 28 x 16 = 12,544 numbers. F-C1 therefore has
    12,544 + 1024 = 13,568 inputs. Before the fusion, the features of each layer are divided by
    their :math:`\ell_2` norm.

    The paper does not state whether ReLU follows F-C1, or which Xavier distribution initialises the
    weights. This implementation applies ReLU and uses the uniform distribution. C1 has no bias,
    since batch normalisation follows.

    Args:
        layout (TaxelLayout, str or PathLike, optional): The layout, the name of a stock layout or
            the path of a layout file. Its :obj:`image_map` must have at least 20 x 20 cells. Cells
            without a taxel are zero. Defaults to
            :func:`~torch_geometric_tactile.sensors.letter_array`.
        out_channels (int): Number of classes :math:`C`.
        in_channels (int): Number of input features per taxel :math:`F`.
        fusion (str): Inputs of F-C1, as named in the paper's Table 4: :obj:`"C3"`,
            :obj:`"bilinear(C1)+C3"`, :obj:`"C1+C3"`, :obj:`"bilinear(C2)+C3"` or :obj:`"C2+C3"`.
            Without a fusion, the features from C3 are not divided by their norm.
        bilinear (bool): If :obj:`False`, creates the paper's traditional CNN, which is the same as
            :obj:`fusion="C3"`.
        hidden_channels (int): Width of F-C1.

    Shapes:
        - **input:** images :math:`(B, F, H, W)`, or readings :math:`(N, F)`, :math:`(B, N, F)` or,
          for a PyG batch, :math:`(B \cdot N, F)`
        - **output:** logits :math:`(B, C)`

    Raises:
        ValueError: If the layout has no image map or its image map is too small, :obj:`fusion` is
            unknown or contradicts :obj:`bilinear`, a size is below one, or the input has the wrong
            shape.

    Examples:
        >>> model = BMFCNN()
        >>> model
        BMFCNN(1024, 26, in_channels=1, fusion='bilinear(C1)+C3', size=(32, 32))
        >>> model(torch.zeros(2, 1, 32, 32)).shape
        torch.Size([2, 26])
        >>> model(torch.zeros(2, 1024, 1)).shape
        torch.Size([2, 26])
        >>> BMFCNN(bilinear=False).fc1
        Linear(in_features=1024, out_features=120, bias=True)
    """

    def __init__(
        self,
        layout: Optional[Union[TaxelLayout, PathLike]] = None,
        out_channels: int = 26,
        *,
        in_channels: int = 1,
        fusion: _Fusion = _DEFAULT_FUSION,
        bilinear: bool = True,
        hidden_channels: int = 120,
    ) -> None:
        super().__init__()
        layout = letter_array() if layout is None else load_layout(layout, "its image map")
        check_sizes(
            out_channels=out_channels, in_channels=in_channels, hidden_channels=hidden_channels
        )
        self.fusion = _checked_fusion(fusion, bilinear)
        self.num_nodes = layout.num_taxels
        self.in_channels = in_channels
        self.out_channels = out_channels
        self.image = TaxelImage(layout)
        if min(self.image.size) < MIN_MAP_SIZE:
            raise ValueError(
                f"'layout' must have an image_map of at least {MIN_MAP_SIZE} x {MIN_MAP_SIZE} "
                f"cells (got {' x '.join(map(str, self.image.size))} in '{layout.name}')"
            )
        self.conv1 = Conv2d(in_channels, 16, 5, bias=False)
        self.norm1 = BatchNorm2d(16)
        self.conv2 = Conv2d(16, 32, 3)
        self.conv3 = Conv2d(32, 64, 3)
        self.bilinear_feature = BilinearFeature()
        self.fc1 = Linear(self._fused_channels(), hidden_channels)
        self.fc2 = Linear(hidden_channels, out_channels)
        self.reset_parameters()

    def reset_parameters(self) -> None:
        r"""Resets all learnable parameters, using Xavier initialisation and zero biases."""
        self.norm1.reset_parameters()
        for layer in (self.conv1, self.conv2, self.conv3, self.fc1, self.fc2):
            xavier_uniform_(layer.weight)
            if layer.bias is not None:
                zeros_(layer.bias)

    def _logits(self, x: Tensor, **unused: OptTensor) -> Tensor:
        return self.fc2(self._hidden(self._maps(x)))

    def features(self, x: Tensor) -> dict[str, Tensor]:
        r"""Returns the features of each layer after ReLU and before pooling. The keys are the names
        of the layers in the paper: :obj:`"C1"`, :obj:`"bilinear(C1)"`, :obj:`"C2"`,
        :obj:`"bilinear(C2)"`, :obj:`"C3"` and :obj:`"F-C1"`. The bilinear features are included
        whatever the fusion.

        Args:
            x (torch.Tensor): Images or readings.

        Shapes:
            - **output:** feature maps :math:`(B, F, H, W)`, or :math:`(B, F)` for F-C1
        """
        maps = self._maps(x)
        return {
            "C1": maps["C1"],
            "bilinear(C1)": self.bilinear_feature(maps["C1"]),
            "C2": maps["C2"],
            "bilinear(C2)": self.bilinear_feature(maps["C2"]),
            "C3": maps["C3"],
            "F-C1": self._hidden(maps),
        }

    def _maps(self, x: Tensor) -> dict[str, Tensor]:
        c1 = self.norm1(self.conv1(self._images(x))).relu()
        c2 = self.conv2(F.max_pool2d(c1, 2)).relu()
        c3 = self.conv3(F.max_pool2d(c2, 2)).relu()
        return {"C1": c1, "C2": c2, "C3": c3}

    def _images(self, x: Tensor) -> Tensor:
        is_image = x.shape[-2:] == self.image.size and x.size(-1) != self.in_channels
        if x.dim() != 4 and not is_image:
            return self.image(stacked_readings(x, self.num_nodes, self.in_channels, "channels"))
        rows, columns = self.image.size
        if x.dim() != 4 or x.shape[1:] != (self.in_channels, rows, columns):
            raise ValueError(
                f"'x' must have shape (batch_size, {self.in_channels}, {rows}, {columns}) for "
                f"images (got {tuple(x.shape)})"
            )
        return x

    def _hidden(self, maps: dict[str, Tensor]) -> Tensor:
        low, _, high = self.fusion.rpartition("+")
        rows = maps[high].flatten(1)
        if not low:
            return self.fc1(rows).relu()
        rows = F.normalize(rows)
        if low in maps:
            return self.fc1(torch.cat([F.normalize(maps[low].flatten(1)), rows], dim=1)).relu()
        source = maps[low.removeprefix("bilinear(").removesuffix(")")]
        # `torch.onnx` is imported on access, which is slow, so tracing is checked first.
        if torch.compiler.is_compiling() and torch.onnx.is_in_onnx_export() and self._is_plain():
            return _linear_of_symmetric(self.fc1, self.bilinear_feature, source, rows).relu()
        feature = self.bilinear_feature(source)
        # Each map has norm one, so this divides by the norm over all maps.
        feature = feature / feature.size(1) ** 0.5
        return self.fc1(torch.cat([feature.flatten(1), rows], dim=1)).relu()

    def _is_plain(self) -> bool:
        expected_types = ((self.fc1, Linear), (self.bilinear_feature, BilinearFeature))
        return all(type(layer) is cls and not is_hooked(layer) for layer, cls in expected_types)

    def _fused_channels(self) -> int:
        rows, columns = self.image.size
        sizes = {}
        for name, width, kernel in (("C1", 16, 5), ("C2", 32, 3), ("C3", 64, 3)):
            rows, columns = rows - kernel + 1, columns - kernel + 1
            sizes[name] = width * rows * columns
            sizes[f"bilinear({name})"] = width * columns * columns
            rows, columns = rows // 2, columns // 2
        return sum(sizes[name] for name in self.fusion.split("+"))

    def extra_repr(self) -> str:
        r"""Returns the sizes and the fusion for :obj:`repr`."""
        return (
            f"{self.num_nodes}, {self.out_channels}, in_channels={self.in_channels}, "
            f"fusion='{self.fusion}', size={self.image.size}"
        )


def _linear_of_symmetric(
    lin: Linear, bilinear: BilinearFeature, source: Tensor, rows: Tensor
) -> Tensor:
    # Returns the output of `lin` for the bilinear feature and `rows`, for an export. The feature is
    # symmetric, so most pairs of equal numbers are multiplied only once, by the sum of their
    # weights. For a single image, most of the time goes into reading weights from memory, and this
    # method reads 4 of 7 weights. The upper triangle is cut into strips, since gathering single
    # numbers is slower than reading some redundant ones. An ONNX runtime adds the weights when it
    # loads the file; PyTorch would add them at each call.
    num_maps, width = source.size(1), source.size(-1)
    weight, row_weight = lin.weight.tensor_split([num_maps * width * width], dim=1)
    weight = weight.view(-1, num_maps, width, width)
    transposed_weight = weight.mT
    phi = bilinear.products(source)
    height = -(-width // _NUM_STRIPS)
    products, weights, counts = [], [], []
    for start in range(0, width, height):
        stop = min(start + height, width)
        square = (..., slice(start, stop), slice(start, stop))
        right = (..., slice(start, stop), slice(stop, width))
        sums = torch.cat([weight[square], weight[right] + transposed_weight[right]], dim=-1)
        products.append(phi[..., start:stop, start:].flatten(2))
        weights.append(sums.flatten(2))
        # In the norm, each number to the right of the square also counts for its mirror image.
        count = phi.new_full((stop - start, width - start), 2.0)
        count[:, : stop - start] = 1.0
        counts.append(count.flatten())
    root = bilinear._signed_root(torch.cat(products, dim=2))  # (B, maps, products)
    # The norm of each map times the root of the number of maps, which gives the norm over all maps.
    norm = (root * root @ torch.cat(counts) * num_maps).sqrt()
    feature = (root / norm.unsqueeze(-1)).flatten(1)
    weight = torch.cat([torch.cat(weights, dim=2).flatten(1), row_weight], dim=1)
    return F.linear(torch.cat([feature, rows], dim=1), weight, lin.bias)


def _checked_fusion(fusion: str, bilinear: bool) -> str:
    if fusion not in _FUSIONS:
        raise ValueError(f"'fusion' must be one of {_FUSIONS} (got {fusion!r})")
    if bilinear:
        return fusion
    # The default of `fusion` does not contradict `bilinear=False`, since users may not have set it.
    if fusion not in ("C3", _DEFAULT_FUSION):
        raise ValueError(f"'fusion' must be 'C3' if 'bilinear' is False (got '{fusion}')")
    return "C3"
