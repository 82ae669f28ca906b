"""Trains `scenarios/policies/grey.npz`: the rest of the way to a goal picture, from small grey
pictures of a poster.

    pip install torch
    python tests/long/train_grey.py [--out FILE.npz] [--seed 0] [--pictures 20000] [--minutes 15]

An ideal camera is put to random poses round the goal of `arm_photometric`, in the arm's world
without the arm; half of them are much nearer than the farthest, so that the end is learned as well
as the start. The light of the pictures varies in training alone: brightness and contrast, noise.
`grey.csv` keeps the curve: of each minute the loss and, of pictures that were not trained on, the
median relative error.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import nn

import vstestbed as vs
from vstestbed.core.geometry import Pose, exp, inverse, log
from vstestbed.imaging.chain import scaled
from vstestbed.laws.photometric import luminance

POLICY = Path(__file__).parents[2] / "scenarios" / "policies" / "grey.py"
SIZE = (80, 60)
# [m], [deg], along and about the axes of the camera at the goal
FARTHEST = np.array([0.25, 0.25, 0.2]), np.array([15.0, 15.0, 50.0])
NEAREST = 0.01  # least share of these
LEAST = 2e-3  # ways under this [m, rad] count by their absolute error


def pictures(n, rng):
    """Grey pictures (n, H, W), the ways to the goal as twists of the camera (n, 6), and the goal's
    picture (H, W).
    """
    scenario = vs.load("arm_photometric")
    goal = scenario.target.pose.T @ inverse(scenario.goal_view.T_camera_target)
    start = {"kind": "free", "start": {"nominal": Pose.of(goal).__dict__}}
    stop = {
        "duration_s": 80_000,
        "converged": {"error_grey": 1e-6, "hold_s": 1000},
        "lost_after_s": 80_000,
        "lost_after_m": 1000,
    }
    seen, ways = [], []
    with vs.Session(
        vs.load("arm_photometric", {"robot": start, "camera.latency_s": 0, "stop": stop})
    ) as session:
        frame, T = session.reset(), goal
        first = luminance(scaled(frame.observation.image.image, SIZE))
        for _ in range(n):
            share = (
                np.exp(rng.uniform(np.log(NEAREST), 0)) if rng.uniform() < 0.5 else rng.uniform()
            )
            away = np.eye(4)
            away[:3, 3] = share * FARTHEST[0] * rng.uniform(-1, 1, 3)
            away[:3, :3] = Rotation.from_euler(
                "xyz", share * FARTHEST[1] * rng.uniform(-1, 1, 3), degrees=True
            ).as_matrix()
            frame = session.step(log(inverse(T) @ goal @ away) / scenario.camera.period)
            T = frame.truth.T_world_camera
            seen.append(luminance(scaled(frame.observation.image.image, SIZE)))
            ways.append(log(inverse(T) @ goal))
            assert np.allclose(T @ exp(ways[-1]), goal)
            if frame.outcome is not None:
                frame, T = session.reset(), goal
    return np.array(seen, np.float32), np.array(ways, np.float32), first


class Network(nn.Module):
    """f of `Grey`."""

    def __init__(self):
        super().__init__()
        sizes = ((1, 16, 5), (16, 32, 3), (32, 64, 3), (64, 64, 3))
        self.layers = nn.ModuleList(nn.Conv2d(a, b, k, 2, k // 2) for a, b, k in sizes)
        self.hidden, self.out = nn.Linear(64 * 4 * 5, 128), nn.Linear(128, 6, bias=False)

    def forward(self, x):
        """Of pictures (n, H, W)."""
        x = (x - x.mean((1, 2), keepdim=True)) / (x.std((1, 2), keepdim=True, correction=0) + 1.0)
        x = x[:, None]
        for layer in self.layers:
            x = torch.relu(layer(x))
        return self.out(torch.relu(self.hidden(x.flatten(1))))


def main():
    """Take pictures, train, and write weights and curve."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=POLICY.with_suffix(".npz"))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--pictures", type=int, default=20_000)
    parser.add_argument("--minutes", type=float, default=15)
    options = parser.parse_args()
    torch.manual_seed(options.seed)
    torch.set_num_threads(1)
    rng, began = np.random.default_rng(options.seed), time.perf_counter()
    seen, ways, first = (torch.from_numpy(a) for a in pictures(options.pictures, rng))
    print(f"{len(seen)} pictures, {time.perf_counter() - began:.0f} s", flush=True)
    kept, net, rows, losses = len(seen) * 9 // 10, Network(), [], []
    adam, began = torch.optim.Adam(net.parameters(), lr=1e-3), time.perf_counter()
    while (spent := (time.perf_counter() - began) / (60 * options.minutes)) < 1:
        for group in adam.param_groups:
            group["lr"] = 1e-3 * (0.5 + 0.5 * np.cos(np.pi * spent)) + 1e-7
        pick = torch.from_numpy(rng.integers(kept, size=128))
        light = torch.from_numpy(rng.uniform((0.8, -20), (1.2, 20), (128, 2)).astype(np.float32))[
            ..., None, None
        ]
        x = (light[:, 0] * seen[pick] + light[:, 1] + 2 * torch.randn(128, *seen.shape[1:])).clamp(
            0, 255
        )
        wanted = ways[pick]
        error = net(x) - net(first[None]) - wanted
        loss = torch.log1p((error**2).sum(-1) / (wanted.norm(dim=-1) + LEAST) ** 2).mean()
        adam.zero_grad()
        loss.backward()
        adam.step()
        losses.append(loss.item())
        if spent * options.minutes >= len(rows) + 1 or spent == 0:
            rows.append(
                (
                    spent * options.minutes,
                    np.mean(losses[-200:]),
                    tested(net, seen[kept:], ways[kept:], first),
                )
            )
            print("{:.1f} min, loss {:.4f}, relative error {:.3f}".format(*rows[-1]), flush=True)
    rows.append(
        (options.minutes, np.mean(losses[-200:]), tested(net, seen[kept:], ways[kept:], first))
    )
    print("{:.1f} min, loss {:.4f}, relative error {:.3f}".format(*rows[-1]), flush=True)
    found = {
        f"{'W' if kind == 'weight' else 'b'}{i}": getattr(layer, kind)
        for i, layer in enumerate(net.layers)
        for kind in ("weight", "bias")
    }
    found |= {"W4": net.hidden.weight, "b4": net.hidden.bias, "W5": net.out.weight}
    np.savez_compressed(
        options.out,
        **{name: value.detach().numpy().astype(np.float16) for name, value in found.items()},
    )
    np.savetxt(
        options.out.with_suffix(".csv"),
        np.array(rows),
        "%.6g",
        ",",
        header="minutes,loss,relative_error",
        comments="",
    )


def tested(net, seen, ways, first):
    """Median of the errors over the ways, of pictures that were not trained on."""
    with torch.no_grad():
        error = torch.cat([net(part) for part in seen.split(256)]) - net(first[None]) - ways
    return float((error.norm(dim=-1) / (ways.norm(dim=-1) + LEAST)).median())


if __name__ == "__main__":
    main()
