"""The architecture of our own network: a small U-Net from half resolution down, whose receptive field is the region.

Two channels in (image and expected wall, relative to the plain wall), the logit of P(body) out, both at full
resolution. The stem halves the resolution at once and the last layer gives four logits a position, which costs a
quarter of what a full first level would. Dilated layers at 1/16 and their mean over the region see all of it.
"""

from torch import Tensor, nn
from torch.nn import functional

WIDTHS = (8, 16, 48, 64)
"""Channels at 1/2, 1/4, 1/8 and 1/16 of the resolution."""


class BodyNetwork(nn.Module):  # type: ignore[misc] # torch is not there when this is checked
    """Logits (N, 1, H, W) of P(body) from views (N, 2, H, W); H and W are multiples of 16."""

    def __init__(self, widths: tuple[int, int, int, int] = WIDTHS) -> None:
        super().__init__()
        a, b, c, d = widths
        self.level_2 = _layer(2, a, stride=2)
        self.level_4 = nn.Sequential(_layer(a, b, stride=2), _layer(b, b))
        self.level_8 = nn.Sequential(_layer(b, c, stride=2), _layer(c, c))
        self.level_16 = nn.Sequential(
            _layer(c, d, stride=2), _layer(d, d, dilation=2), _layer(d, d, dilation=4)
        )
        self.whole = nn.Conv2d(d, d, 1)
        self.to_eighth = nn.Conv2d(d, c, 1)
        self.to_quarter = nn.Conv2d(c, b, 1)
        self.to_half = nn.Conv2d(b, a, 1)
        self.up_eighth, self.up_quarter, self.up_half = _layer(c, c), _layer(b, b), _layer(a, a)
        self.out = nn.Conv2d(a, 4, 1)

    def forward(self, view: Tensor) -> Tensor:
        half = self.level_2(view)
        quarter = self.level_4(half)
        eighth = self.level_8(quarter)
        deep = self.level_16(eighth)
        deep = functional.relu(deep + self.whole(deep.mean(dim=(2, 3), keepdim=True)))
        eighth = self.up_eighth(eighth + _doubled(self.to_eighth(deep)))
        quarter = self.up_quarter(quarter + _doubled(self.to_quarter(eighth)))
        half = self.up_half(half + _doubled(self.to_half(quarter)))
        logits: Tensor = functional.pixel_shuffle(self.out(half), 2)
        return logits


def n_parameters(network: nn.Module) -> int:
    return sum(parameter.numel() for parameter in network.parameters())


def _layer(n_in: int, n_out: int, stride: int = 1, dilation: int = 1) -> nn.Module:
    return nn.Sequential(
        nn.Conv2d(n_in, n_out, 3, stride, padding=dilation, dilation=dilation, bias=False),
        nn.BatchNorm2d(n_out),
        nn.ReLU(),
    )


def _doubled(features: Tensor) -> Tensor:
    return functional.interpolate(features, scale_factor=2.0, mode="nearest")
