"""The part of a frame that the upscaler's kernels work on: see ``postfx.kernels.denoise_layout``."""
from typing import NamedTuple

import torch
from torch import Tensor

from training.networks import ops, phases


def to_image(picture: Tensor) -> Tensor:
    """(H, W, C) -> (1, C, H, W)."""
    return picture.permute(2, 0, 1)[None]


def to_picture(image: Tensor) -> Tensor:
    """(1, C, H, W) -> (H, W, C)."""
    return image[0].permute(1, 2, 0)


class Window(NamedTuple):
    """The part of the frame to work on: its first row and column, the frame's size, and both at output size."""

    top: Tensor
    left: Tensor
    h: Tensor
    w: Tensor
    out_top: Tensor
    out_left: Tensor
    height: Tensor
    width: Tensor

    @classmethod
    def of(cls, window: Tensor) -> "Window":
        return cls(*window.long().unbind())

    def held(self, part: Tensor) -> ops.Place:
        """Rows and columns of the frame that a part (h, w, C) holds; its last ones are repeated."""
        rows, columns = counted(part)
        return (rows + self.top).clamp(max=self.h - 1), (columns + self.left).clamp(max=self.w - 1)

    def valid(self, part: Tensor) -> Tensor:
        """(h, w, 1): 1 where a part (h, w, C) lies in the frame, else 0."""
        rows, columns = counted(part)
        return ((rows + self.top < self.h)[:, None] & (columns + self.left < self.w))[..., None].to(part.dtype)

    def edge(self, part: Tensor) -> Tensor:
        """(h, w, 1): 1 at the edge of a part (h, w, C) where the frame goes on, else 0."""
        (rows, columns), (h, w) = counted(part), part.shape[:2]
        down = ((rows == 0) & (self.top > 0)) | ((rows == h - 1) & (self.top + h < self.h))
        across = ((columns == 0) & (self.left > 0)) | ((columns == w - 1) & (self.left + w < self.w))
        return (down[:, None] | across)[..., None].to(part.dtype)

    def outputs(self, part: Tensor) -> ops.Place:
        """Rows and columns of the frame at output size that a part (H, W, C) holds; its last ones are repeated."""
        rows, columns = counted(part)
        return (rows + self.out_top).clamp(max=self.height - 1), (columns + self.out_left).clamp(max=self.width - 1)

    def centres(self, at: ops.Place, moved: Tensor) -> phases.Centres:
        """Where, in a part ``moved`` (h, w, C), the frame's pixels ``at`` output size lie."""
        sizes = (self.h, self.height), (self.w, self.width)
        (rows, y), (columns, x) = (ops.nearest_of(index, *size) for index, size in zip(at, sizes, strict=True))
        return phases.Centres((rows - self.top).clamp(0, moved.shape[0] - 1), y,
                              (columns - self.left).clamp(0, moved.shape[1] - 1), x)

    def enlarged_motion(self, moved: Tensor, at: phases.Centres) -> Tensor:
        """Motion (h, w, 2) of a part at output size (1, 2, H, W), in output pixels."""
        scale = torch.stack((self.width / self.w, self.height / self.h)).to(moved.dtype)
        return ops.pick(to_image(moved * scale), at.rows, at.columns)


def counted(picture: Tensor) -> ops.Place:
    """Numbers of the rows and columns of a picture (h, w, C)."""
    return tuple(torch.arange(size, device=picture.device) for size in picture.shape[:2])


def part(picture: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
    """Rows and columns of a picture, as (1, C, h, w)."""
    return ops.pick(to_image(picture), rows, columns)


def shares(keep: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
    """Rows and columns of ``keep``, as (1, 1, h, w); (1, 1, 1) holds for all of them."""
    return part(keep, rows.clamp(max=keep.shape[0] - 1), columns.clamp(max=keep.shape[1] - 1))
