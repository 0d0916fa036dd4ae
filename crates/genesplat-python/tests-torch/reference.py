"""Splatting as plain formulas, derived by PyTorch: what the rasteriser is compared with."""

import torch


def rotations(quats):
    w, x, y, z = torch.nn.functional.normalize(quats, dim=-1).unbind(-1)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return torch.stack([torch.stack(row, -1) for row in rows], -2)


def project(means, quats, scales, viewmat, K, width, height):
    """Means and covariances on the screen before dilation, and depths."""
    t = means @ viewmat[:3, :3].T + viewmat[:3, 3]
    focal = torch.stack([K[0, 0], K[1, 1]])
    limit = 1.3 * torch.tensor([width, height]) / (2 * focal)
    slopes = t[:, :2] / t[:, 2:]
    bent = torch.minimum(torch.maximum(slopes, -limit), limit)
    jacobian = means.new_zeros(len(means), 2, 3)
    jacobian[:, 0, 0], jacobian[:, 1, 1] = focal[0] / t[:, 2], focal[1] / t[:, 2]
    jacobian[:, :, 2] = -focal * bent / t[:, 2:]
    half = jacobian @ viewmat[:3, :3] @ rotations(quats) @ torch.diag_embed(scales)
    return focal * slopes + K[:2, 2], half @ half.transpose(1, 2), t[:, 2]


def harmonics(coefficients, directions, degree):
    """Colours from coefficients [N, K, 3] (Sloan, "Efficient spherical harmonic evaluation", 2013)."""
    x, y, z = torch.nn.functional.normalize(directions, dim=-1).unbind(-1)
    one = torch.ones_like(x)
    basis = [
        0.28209479177387814 * one,
        -0.4886025119029199 * y,
        0.4886025119029199 * z,
        -0.4886025119029199 * x,
    ]
    basis += [1.0925484305920792 * x * y, -1.0925484305920792 * y * z, 0.31539156525252005 * (3 * z * z - 1)]
    basis += [-1.0925484305920792 * x * z, 0.5462742152960396 * (x * x - y * y)]
    basis += [-0.5900435899266435 * y * (3 * x * x - y * y), 2.890611442640554 * x * y * z]
    basis += [-0.4570457994644658 * y * (5 * z * z - 1), 0.3731763325901154 * z * (5 * z * z - 3)]
    basis += [-0.4570457994644658 * x * (5 * z * z - 1), 1.445305721320277 * z * (x * x - y * y)]
    basis += [-0.5900435899266435 * x * (x * x - 3 * y * y)]
    count = (degree + 1) ** 2
    summed = (torch.stack(basis[:count], -1).unsqueeze(-1) * coefficients[:, :count]).sum(1)
    return (summed + 0.5).clamp(min=0)


def rasterization(
    means,
    quats,
    scales,
    opacities,
    colors,
    viewmat,
    K,
    width,
    height,
    sh_degree=None,
    depth=False,
    antialiased=False,
    cuts=None,
):
    """One picture [H, W, D], its alpha [H, W], and where Gaussians count, which `cuts` prescribes."""
    means2d, raw, depths = project(means, quats, scales, viewmat, K, width, height)
    if sh_degree is not None:
        colors = harmonics(colors, means - viewmat.inverse()[:3, 3], sh_degree)
    if depth:
        colors = torch.cat([colors, depths.unsqueeze(-1)], -1)
    covariances = raw + 0.3 * torch.eye(2)
    if antialiased:
        opacities = opacities * (raw.det() / covariances.det()).clamp(min=2.5e-5).sqrt()
    conics = covariances.inverse()
    y, x = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    picture, left = means.new_zeros(height, width, colors.shape[-1]), means.new_ones(height, width)
    going_on, made = torch.ones(height, width, dtype=torch.bool), []
    rows = depths.argsort(stable=True).tolist() if cuts is None else [row for row, _ in cuts]
    for place, row in enumerate(rows):
        offset = torch.stack([x, y], -1) - means2d[row]
        exponent = ((offset @ conics[row]) * offset).sum(-1)
        unclamped = opacities[row] * torch.exp(-exponent / 2)
        # The clamp has the derivative of what it clamps, as in 3DGS.
        alpha = unclamped + (unclamped.clamp(max=0.99) - unclamped).detach()
        if cuts is None:
            hit = (alpha >= 1 / 255) & (depths[row] > 0.01)
            going_on = going_on & (~hit | (left * (1 - alpha) >= 1e-4))
            made.append((row, hit & going_on))
        alpha = torch.where((made if cuts is None else cuts)[place][1], alpha, torch.zeros_like(alpha))
        picture = picture + (left * alpha).unsqueeze(-1) * colors[row]
        left = left * (1 - alpha)
    return picture, 1 - left, made
