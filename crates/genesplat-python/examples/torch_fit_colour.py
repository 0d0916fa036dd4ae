"""Fits the colours of a cloud to a picture of it, through the rasteriser's gradients: code for gsplat, on
any CPU.
"""

import torch

from genesplat.torch import rasterization

torch.manual_seed(0)
means, quats = (torch.rand(200, 3) - 0.5) * 2, torch.rand(200, 4)
scales, opacities = torch.full((200, 3), 0.1), torch.full((200,), 0.9)
viewmats, Ks = torch.eye(4)[None], torch.tensor([[[120.0, 0.0, 64.0], [0.0, 120.0, 48.0], [0.0, 0.0, 1.0]]])
viewmats[0, 2, 3] = 3.0
photo = rasterization(means, quats, scales, opacities, torch.rand(200, 3), viewmats, Ks, 128, 96)[0]

colors = torch.full((200, 3), 0.5, requires_grad=True)
optimizer = torch.optim.Adam([colors], lr=0.05)
for step in range(100):
    image, alpha, meta = rasterization(means, quats, scales, opacities, colors, viewmats, Ks, 128, 96)
    loss = (image - photo).square().mean()
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
print(f"mean squared error {loss.item():.2e}, of {len(meta['gaussian_ids'])} splats that are seen")
