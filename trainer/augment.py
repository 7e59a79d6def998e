"""Image-space augmentation (paper, "Image-Space Data Augmentation"), before equalisation.

The order is fixed: thin-plate spline, perspective, rescale, blur, noise, posterise, erasing - what the cloth and the
camera do to the geometry first, what the sensor does to the readings next, what goes missing last.
"""

from __future__ import annotations

import kornia.augmentation as kornia
import torch
from torch import Tensor, nn

from trainer.config import AugmentConfig

FULL_HEIGHT_M = 0.512
"""Height that becomes 1 where kornia wants [0, 1]."""
_LIFT = 0.25


class Augmenter:
    """Random deformations of pictures.

    kornia draws from torch's global generator; each call seeds a fork of it, so that a batch depends on its seed alone.
    """

    def __init__(self, config: AugmentConfig) -> None:
        self.config = config
        shift = (config.shift_share, config.shift_share)
        scale = (1 - config.rescale_share, 1 + config.rescale_share)
        self._deform = nn.Sequential(
            kornia.RandomThinPlateSpline(config.thin_plate_scale, p=config.thin_plate),
            kornia.RandomPerspective(config.perspective_scale, sampling_method="area_preserving", p=config.perspective),
            kornia.RandomAffine(config.rotation_deg, translate=shift, scale=scale, p=config.rescale),
            kornia.RandomGaussianBlur((5, 5), config.blur_sigma_px, p=config.blur),
            kornia.RandomGaussianNoise(0.0, config.noise_std_m / FULL_HEIGHT_M, p=config.noise),
        )
        self._erase = kornia.RandomErasing(config.erase_share, p=config.erase)

    @torch.no_grad()
    def __call__(self, pictures: Tensor, seed: int) -> Tensor:
        """Deform each picture at random.

        Args:
            pictures: heights [m], float32, shape [pictures, 1, H, W].
            seed: of this batch.

        Returns:
            Heights, same shape.
        """
        if not self.config.active:
            return pictures
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed % 2**64)  # it takes no more, and the rest of a training takes seeds of any size
            height = self._deform(pictures / FULL_HEIGHT_M)
            # Noise can reach behind the panel.
            height = self._posterise(height.clamp(-_LIFT, 1.0 - _LIFT))
            erased: Tensor = self._erase(height * FULL_HEIGHT_M)
        return erased

    def _posterise(self, height: Tensor) -> Tensor:
        """A share of the pictures rounded to steps of 1 / 2^bits, so that the panel stays where it is."""
        count, (fewest, most) = len(height), self.config.posterise_bits
        chosen = torch.rand(count) < self.config.posterise
        step = 2.0 ** -torch.randint(fewest, most + 1, (count,)).to(height.dtype)
        chosen, step = chosen[:, None, None, None], step[:, None, None, None]
        return torch.where(chosen, (height / step).round() * step, height)
