"""The upscaler's compute kernels as torch modules with the kernels' own bindings: what is exported to ONNX.

Pictures are (H, W, C) as in ``postfx.kernels``, pyramid levels (C, H, W); ``params`` is (5,): exposure, jitter x,
jitter y, fresh, gain. Every size is read off a binding, so that one file serves all sizes.
"""
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from training.networks import denoise_upscale as step
from training.networks import ops
from training.networks.denoise_upscale import Guides, Inputs, State
from training.networks.trunk import DISTRUST, FINE, IMPORTANCE, KERNEL, MEMORY, MIX, activated, weights_from


def to_image(picture: Tensor) -> Tensor:
    """(H, W, C) -> (1, C, H, W)."""
    return picture.permute(2, 0, 1)[None]


def to_picture(image: Tensor) -> Tensor:
    """(1, C, H, W) -> (H, W, C)."""
    return image[0].permute(1, 2, 0)


def expose(colour: Tensor, params: Tensor) -> Tensor:
    """Exposed colour (1, 3, h, w) from a file's; sanitised first, for infinity times 0 is NaN."""
    return ops.sanitise(to_image(colour), 0, step.MAX_FLOAT) * params[0]


class Scale(nn.Module):
    """depth (h, w, 1) -> depth_scale (1,)."""

    def forward(self, depth: Tensor) -> Tensor:
        return ops.depth_scale(to_image(depth)).reshape(1)


class Dilate(nn.Module):
    """motion (h, w, 2), depth (h, w, 1) -> moved (h, w, 2)."""

    def forward(self, motion: Tensor, depth: Tensor) -> Tensor:
        return to_picture(ops.dilate_motion(to_image(motion), to_image(depth)))


class History(nn.Module):
    """history (H, W, 3), moved (h, w, 2), params -> warped (H, W, 3)."""

    def forward(self, history: Tensor, moved: Tensor, params: Tensor) -> Tensor:
        return to_picture(step.reproject_output(to_image(history), to_image(moved), params[4]))


class Features(nn.Module):
    """The frame and what it remembers -> past (h, w, 4), features (1, 35, hp, wp), padded to multiples of 16."""

    def forward(self, colour: Tensor, diffuse_albedo: Tensor, specular_albedo: Tensor, normal: Tensor,
                roughness: Tensor, depth: Tensor, moved: Tensor, state: Tensor, last_depth: Tensor, warped: Tensor,
                depth_scale: Tensor, params: Tensor) -> tuple[Tensor, Tensor]:
        planes = (diffuse_albedo, specular_albedo, normal, roughness, depth, moved)
        inputs = Inputs(expose(colour, params), *map(to_image, planes), params[None, 1:3], params[4])
        output, old, fresh = to_image(warped), to_image(state), params[3].reshape(1, 1, 1, 1)
        before = State(output, old[:, :3], old[:, 3:4], old[:, 4:], to_image(last_depth), fresh)
        past = step.recall(inputs, before, inputs.motion, output)
        factor = ops.demodulation(inputs.diffuse_albedo, inputs.specular_albedo)
        features = step.features(inputs, past, factor, depth_scale.reshape(1, 1, 1, 1))
        return to_picture(torch.cat((past.accumulated, past.count), 1)), step.aligned(features)


class GuideFeatures(nn.Module):
    """depth (h, w, 1), guides (H, W, C), depth_scale -> guides (1, 44, hp, wp), padded to multiples of 16."""

    def forward(self, depth: Tensor, diffuse_albedo: Tensor, specular_albedo: Tensor, normal: Tensor,
                roughness: Tensor, guide_depth: Tensor, depth_scale: Tensor) -> Tensor:
        h, w = depth.shape[:2]
        guides = Guides(*map(to_image, (diffuse_albedo, specular_albedo, normal, roughness, guide_depth)))
        return step.aligned(step.guide_features(guides, h, w, depth_scale.reshape(1, 1, 1, 1)))


class Accumulate(nn.Module):
    """Frame, past (h, w, 4), fine -> next_state (h, w, 12), next_depth (h, w, 1), level (4, hp, wp)."""

    def forward(self, colour: Tensor, diffuse_albedo: Tensor, specular_albedo: Tensor, depth: Tensor, past: Tensor,
                fine: Tensor, params: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        h, w = colour.shape[:2]
        here, old = fine[:, :, :h, :w], to_image(past)
        factor = ops.demodulation(to_image(diffuse_albedo), to_image(specular_albedo))
        noisy = step.demodulate(expose(colour, params), factor)
        accumulated, count = step.accumulate(noisy, old[:, :3], old[:, 3:], here[:, DISTRUST:IMPORTANCE])
        state = torch.cat((accumulated, count, here[:, MEMORY:]), 1)
        level = torch.cat((accumulated, here[:, IMPORTANCE:MEMORY]), 1)
        level = F.pad(level, (0, fine.shape[3] - w, 0, fine.shape[2] - h))
        return to_picture(state), depth.clone(), level[0]


class Pool(nn.Module):
    """finer (4, 2 hp, 2 wp) -> level (4, hp, wp)."""

    def forward(self, finer: Tensor) -> Tensor:
        return torch.cat(ops.pool(finer[None, :3], finer[None, 3:]), 1)[0]


class Mix(nn.Module):
    """coarse (3, hp / 2, wp / 2), level (4, hp, wp), heads (1, 26 or 80, hp, wp) -> mixed (3, hp, wp)."""

    def forward(self, coarse: Tensor, level: Tensor, heads: Tensor) -> Tensor:
        # The mix is the last of a level's 26 channels, but not of the fine head's: by arithmetic, without a branch.
        at = KERNEL + (MIX - KERNEL) * torch.sym_min(heads.shape[1] - KERNEL - 1, 1)
        share = heads.narrow(1, at, 1)[0]
        below = F.interpolate(coarse[None], scale_factor=2.0, mode="nearest")[0]
        return torch.lerp(below, level[:3], share)


class Filter(nn.Module):
    """mixed (3 or 4, hp, wp), heads (1, 25 or more, hp, wp), area (2,) rows and columns -> filtered (3, hp, wp)."""

    def forward(self, mixed: Tensor, heads: Tensor, area: Tensor) -> Tensor:
        valid = ops.valid_area(mixed, area[0], area[1])
        return (ops.filter_kernels(mixed[None, :3], heads[:, :KERNEL], valid) * valid)[0]


class Remodulate(nn.Module):
    """filtered (3, hp, wp), albedos (h, w, 3) -> radiance (3, h + 2, w + 2), its edge repeated once around."""

    def forward(self, filtered: Tensor, diffuse_albedo: Tensor, specular_albedo: Tensor) -> Tensor:
        h, w = diffuse_albedo.shape[:2]
        factor = ops.demodulation(to_image(diffuse_albedo), to_image(specular_albedo))
        return F.pad(filtered[None, :, :h, :w] * factor, (1, 1, 1, 1), mode="replicate")[0]


class Pack(nn.Module):
    """planes (1, C, hp, wp) -> packed (1, hp, wp, C and zeros up to a multiple of 8), half precision."""

    def forward(self, planes: Tensor) -> Tensor:
        return F.pad(planes, (0, 0, 0, 0, 0, -planes.shape[1] % 8)).permute(0, 2, 3, 1).half()


class Open(nn.Module):
    """raw (1, hp, wp, 32), half precision -> heads (1, 26, hp, wp), activated."""

    def forward(self, raw: Tensor) -> Tensor:
        heads = raw.float().permute(0, 3, 1, 2)
        return torch.cat((weights_from(heads[:, :KERNEL]), torch.sigmoid(heads[:, KERNEL:KERNEL + 1])), 1)


class OpenFine(nn.Module):
    """raw_fine (1, hp/2, wp/2, 4 * 80), half precision -> fine (1, 80, hp, wp), activated."""

    def forward(self, raw_fine: Tensor) -> Tensor:
        _, rows, columns, _ = raw_fine.shape
        phases = raw_fine.float().reshape(1, rows, columns, 2, 2, FINE)
        return activated(phases.permute(0, 5, 1, 3, 2, 4).reshape(1, FINE, 2 * rows, 2 * columns))


class Upsample(nn.Module):
    """radiance (3, h + 2, w + 2), fine, moved (h, w, 2), warped (H, W, 3), params -> output, next_history (H, W, 3)."""

    def forward(self, radiance: Tensor, fine: Tensor, moved: Tensor, warped: Tensor,
                params: Tensor) -> tuple[Tensor, Tensor]:
        return resolve(radiance, fine, moved, warped, None, params)


class UpsampleGuided(nn.Module):
    """The same with albedos (H, W, 3), by which the radiance is multiplied."""

    def forward(self, radiance: Tensor, fine: Tensor, moved: Tensor, warped: Tensor, diffuse_albedo: Tensor,
                specular_albedo: Tensor, params: Tensor) -> tuple[Tensor, Tensor]:
        factor = ops.demodulation(to_image(diffuse_albedo), to_image(specular_albedo))
        return resolve(radiance, fine, moved, warped, factor, params)


def resolve(radiance: Tensor, fine: Tensor, moved: Tensor, warped: Tensor, factor: Tensor | None,
            params: Tensor) -> tuple[Tensor, Tensor]:
    h, w = moved.shape[:2]
    here = fine[:, :, :h, :w]
    inside = ops.inside(ops.enlarge_motion(to_image(moved), *warped.shape[:2])) * params[3]
    filtered = radiance[None, :, 1:1 + h, 1:1 + w]
    encoded = step.resolve(filtered, here, params[None, 1:3], to_image(warped), inside, factor)
    return to_picture(torch.expm1(encoded) / params[0]), to_picture(encoded)


class Strength(nn.Module):
    """denoised, plain (H, W, 3), strength (H, W, 1), amount (1,) -> output (H, W, 3), exact at both ends."""

    def forward(self, denoised: Tensor, plain: Tensor, strength: Tensor, amount: Tensor) -> Tensor:
        share = ops.sanitise(strength, 0, 1) * ops.sanitise(amount, 0, 1)
        return torch.where(share == 1, denoised, plain + (denoised - plain) * share)


class Resample(nn.Module):
    """image (h, w, C), rows (H,) and columns (W,), positions in the image -> output (H, W, C)."""

    def forward(self, image: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
        return to_picture(ops.resample(to_image(image), rows, columns))
