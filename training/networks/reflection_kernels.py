"""The kernel of reflections' motion as a torch module, see ``postfx.kernels.denoise_reflections``."""
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from postfx.kernels import denoise_reflections as layout
from training.networks import ops

Pair = tuple[Tensor, Tensor]


def around(plane: Tensor) -> Tensor:
    """(H, W, C) -> (H, W, C, 9): the 3x3 neighbours of every pixel, edge repeated, rows first."""
    padded = F.pad(plane.permute(2, 0, 1)[None], (1, 1, 1, 1), mode="replicate")[0].permute(1, 2, 0)
    h, w = plane.shape[:2]
    return torch.stack([padded[y:y + h, x:x + w] for y in range(3) for x in range(3)], -1)


def unit(normal: Tensor) -> Tensor:
    length = normal.square().sum(-1, keepdim=True).sqrt()
    return normal * torch.where(length > 0.1, 1 / length.clamp(min=0.1), torch.zeros_like(length))


class Reflections(nn.Module):
    """motion (h, w, 2), depth, normal, roughness, both albedos, hit_distance (h, w, 1), camera (27,) ->
    reflected (h, w, 2)."""

    def forward(self, motion: Tensor, depth: Tensor, normal: Tensor, roughness: Tensor, diffuse_albedo: Tensor,
                specular_albedo: Tensor, hit_distance: Tensor, camera: Tensor) -> Tensor:
        own = torch.where(motion.abs() < 1e5, motion, torch.zeros_like(motion))
        share = (ops.sanitise(specular_albedo, 0, 1) - ops.sanitise(diffuse_albedo, 0, 1)).sum(-1, keepdim=True)
        chosen = (share > 0) & (roughness <= layout.ROUGHEST) & (hit_distance > 0) & (depth > 0) & (depth < layout.FAR)
        rays = self._rays(depth, camera)
        still, _ = self._motion(camera, rays, 1 / depth)
        most = layout.STILL + layout.PART * own.abs().amax(-1, keepdim=True)
        chosen &= ((still - own).abs() <= most).all(-1, keepdim=True)
        bend, inside = self._curvature(normal, depth, rays, camera)
        inverse, found = self._inverse_distance(hit_distance, depth)
        smooth = 1 - ops.sanitise(roughness, 0, 1)
        inverse = inverse / (smooth * (smooth.sqrt() + 1 - smooth)) + 2 * bend
        stretched = inverse * (rays.square().sum(-1, keepdim=True) + 1).sqrt()
        moved, ahead = self._motion(camera, rays, stretched / (1 + stretched * depth))
        return torch.where(chosen & inside & found & (ahead > 1e-3), moved, own)

    def _rays(self, depth: Tensor, camera: Tensor) -> Tensor:
        h, w = depth.shape[:2]
        x = torch.arange(w) + 0.5 + camera[layout.JITTER] - 0.5 * w
        y = torch.arange(h) + 0.5 + camera[layout.JITTER + 1] - 0.5 * h
        x, y = x / camera[layout.FOCAL], y / camera[layout.FOCAL + 1]
        return torch.stack((x[None].expand(h, w), y[:, None].expand(h, w)), -1)

    def _motion(self, camera: Tensor, rays: Tensor, nearness: Tensor) -> Pair:
        turn = camera[layout.TURN:layout.SHIFT].reshape(3, 3)
        then = rays[..., :1] * turn[0] + rays[..., 1:] * turn[1] + turn[2]
        then = then + camera[layout.SHIFT:layout.WORLD] * nearness
        ahead = then[..., 2:]
        at = then[..., :2] / ahead.clamp(min=float(layout.NEAR))
        return at * camera[layout.FOCAL_THEN:layout.JITTER] - rays * camera[layout.FOCAL:layout.FOCAL_THEN], ahead

    def _inverse_distance(self, hit_distance: Tensor, depth: Tensor) -> Pair:
        """Mean of one over the hit distance, and whether there is any. An edge that is repeated does not count."""
        distance, z = around(hit_distance), around(depth)
        counts = (distance > 0) & ((z - depth[..., None]).abs() <= layout.STEP * depth[..., None])
        counts &= self._in_picture(depth) > 0
        each = torch.where(counts, 1 / distance.clamp(min=float(layout.NEAR)), torch.zeros_like(distance))
        count = counts.to(depth.dtype).sum(-1)
        return each.sum(-1) / count.clamp(min=1), count > 0

    def _in_picture(self, depth: Tensor) -> Tensor:
        """(h, w, 1, 9): 1 for neighbours in the picture."""
        padded = F.pad(torch.ones_like(depth).permute(2, 0, 1), (1, 1, 1, 1)).permute(1, 2, 0)
        h, w = depth.shape[:2]
        return torch.stack([padded[y:y + h, x:x + w] for y in range(3) for x in range(3)], -1)

    def _curvature(self, normal: Tensor, depth: Tensor, rays: Tensor, camera: Tensor) -> Pair:
        """How much a surface bends outwards, and whether a pixel is inside one."""
        directions = unit(normal)
        places = torch.cat((rays, torch.ones_like(depth)), -1) * depth
        facing = directions @ camera[layout.WORLD:].reshape(3, 3)
        near, turned, z = around(directions), around(facing), around(depth)
        place, total, inside = around(places), torch.zeros_like(depth), torch.ones_like(depth) > 0
        for low, high in ((1, 7), (3, 5)):
            for side in (low, high):
                cosine = (near[..., side] * directions).sum(-1, keepdim=True)
                inside = inside & ((z[..., side] - depth).abs() <= layout.STEP * depth) & (cosine >= layout.BEND)
            along = place[..., high] - place[..., low]
            change = ((turned[..., high] - turned[..., low]) * along).sum(-1, keepdim=True)
            total = total + change / along.square().sum(-1, keepdim=True).clamp(min=1e-20)
        return (0.5 * total).clamp(min=0), inside
