"""For writers of renderers: every plane that postfx reads, from what a renderer has; NumPy in, NumPy out.

docs/integration.md goes through all of it; samples/ray_caster.py is a renderer that uses it.
"""

from postfx.depth import (
    depth_from_device,
    depth_from_normalised,
    depth_from_ray,
    depth_to_device,
    depth_with_misses,
    facing_normals,
    normals_from_encoded,
    normals_to_camera,
    normals_to_world,
    ray_from_depth,
)
from postfx.errors import IntegrationError
from postfx.integrate.camera import (
    depth_of,
    perspective,
    pixel_positions,
    positions_from_depth,
    project,
    view_rays,
    with_jitter,
    without_jitter,
)
from postfx.integrate.materials import (
    diffuse_albedo,
    f0_of,
    roughness_from_alpha,
    roughness_from_exponent,
    roughness_from_smoothness,
    specular_albedo,
)
from postfx.integrate.motion import (
    dejitter_motion,
    motion_from_depth,
    motion_from_positions,
    motion_in_pixels,
    rigid_previous_positions,
    skinned_previous_positions,
)
from postfx.integrate.planes import frame_header, write_planes
from postfx.integrate.sampling import exposure_hint, exposure_of_camera, halton, jitter_length, jitter_sequence
from postfx.integrate.surfaces import (
    blend_surfaces,
    fresnel_dielectric,
    fresnel_schlick,
    glass_weights,
    mirrored_normals,
    mirrored_positions,
    unfolded_positions,
)

__all__ = [
    "IntegrationError",
    "blend_surfaces",
    "dejitter_motion",
    "depth_from_device",
    "depth_from_normalised",
    "depth_from_ray",
    "depth_of",
    "depth_to_device",
    "depth_with_misses",
    "diffuse_albedo",
    "exposure_hint",
    "exposure_of_camera",
    "f0_of",
    "facing_normals",
    "frame_header",
    "fresnel_dielectric",
    "fresnel_schlick",
    "glass_weights",
    "halton",
    "jitter_length",
    "jitter_sequence",
    "mirrored_normals",
    "mirrored_positions",
    "motion_from_depth",
    "motion_from_positions",
    "motion_in_pixels",
    "normals_from_encoded",
    "normals_to_camera",
    "normals_to_world",
    "perspective",
    "pixel_positions",
    "positions_from_depth",
    "project",
    "ray_from_depth",
    "rigid_previous_positions",
    "roughness_from_alpha",
    "roughness_from_exponent",
    "roughness_from_smoothness",
    "skinned_previous_positions",
    "specular_albedo",
    "unfolded_positions",
    "view_rays",
    "with_jitter",
    "without_jitter",
    "write_planes",
]
