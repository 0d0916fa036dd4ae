"""genesplat's density control in a training loop of PyTorch, by the interface of gsplat's strategies."""

import torch

from genesplat.strategy import ImprovedStrategy
from genesplat.torch import rasterization

torch.manual_seed(0)
viewmats, Ks = torch.eye(4)[None], torch.tensor([[[100.0, 0.0, 48.0], [0.0, 100.0, 48.0], [0.0, 0.0, 1.0]]])
photo = torch.stack(
    torch.meshgrid(torch.linspace(0, 9, 96).sin(), torch.linspace(0, 9, 96).cos(), indexing="ij"), -1
)
photo = torch.nn.functional.pad(photo * 0.5 + 0.5, (0, 1))[None]
start = {
    "means": torch.rand(50, 3) - 0.5 + torch.tensor([0.0, 0.0, 2.0]),
    "scales": torch.full((50, 3), -3.0),
}
start.update(quats=torch.rand(50, 4), opacities=torch.zeros(50), colors=torch.full((50, 3), 0.5))
params = torch.nn.ParameterDict({name: torch.nn.Parameter(value) for name, value in start.items()})
optimizers = {name: torch.optim.Adam([parameter], lr=0.01) for name, parameter in params.items()}

strategy = ImprovedStrategy(cap_max=400, iterations=600, refine_every=30, verbose=True)
strategy.check_sanity(params, optimizers)
state = strategy.initialize_state(images=photo, viewmats=viewmats, Ks=Ks)
for step in range(600):
    activated = params["scales"].exp(), params["opacities"].sigmoid(), params["colors"]
    image, _, info = rasterization(
        params["means"], params["quats"], *activated, viewmats, Ks, 96, 96, absgrad=True
    )
    strategy.step_pre_backward(params, optimizers, state, step, info)
    loss = (image - photo).abs().mean()
    loss.backward()
    for optimizer in optimizers.values():
        optimizer.step()
        optimizer.zero_grad()
    strategy.step_post_backward(params, optimizers, state, step, info)
print(f"{len(params['means'])} Gaussians, mean absolute error {loss.item():.3f}")
