"""genesplat's density control in a training loop of PyTorch, by the interface of gsplat's strategies."""

import torch

from genesplat.strategy import ImprovedStrategy
from genesplat.torch import rasterization

waves = torch.linspace(0, 9, 96).sin() / 2 + 0.5
photo = torch.stack([waves.outer(waves), waves.expand(96, 96), waves.outer(1 - waves)], dim=-1)[None]
viewmats, Ks = torch.eye(4)[None], torch.tensor([[[96.0, 0.0, 48.0], [0.0, 96.0, 48.0], [0.0, 0.0, 1.0]]])
start = {"means": torch.rand(50, 3) + torch.tensor([-0.5, -0.5, 1.5]), "quats": torch.rand(50, 4)}
start |= {"scales": torch.full((50, 3), -3.0), "opacities": torch.zeros(50), "colors": torch.rand(50, 3)}
params = torch.nn.ParameterDict(start)
optimizers = {name: torch.optim.Adam([params[name]], lr=0.01) for name in params}
strategy = ImprovedStrategy(cap_max=400, iterations=600, refine_every=30, verbose=True)
state = strategy.initialize_state(images=photo, viewmats=viewmats, Ks=Ks)
for step in range(600):
    splats = params["means"], params["quats"], params["scales"].exp(), params["opacities"].sigmoid()
    image, _, info = rasterization(*splats, params["colors"], viewmats, Ks, 96, 96, absgrad=True)
    strategy.step_pre_backward(params, optimizers, state, step, info)
    loss = (image - photo).abs().mean()
    loss.backward()
    for optimizer in optimizers.values():
        optimizer.step()
        optimizer.zero_grad()
    strategy.step_post_backward(params, optimizers, state, step, info)
print(f"{len(params['means'])} Gaussians, mean absolute error {loss.item():.3f}")
