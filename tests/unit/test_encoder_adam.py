import subprocess
import sys

import pytest
import torch

from babble.adam import Adam


def network():
    torch.manual_seed(0)
    return torch.nn.Sequential(torch.nn.Linear(3, 8), torch.nn.Tanh(), torch.nn.Linear(8, 1))


def descend(net, optimiser, steps, seed=1):
    generator = torch.Generator().manual_seed(seed)
    for _ in range(steps):
        x = torch.randn(16, 3, generator=generator)
        optimiser.zero_grad()
        (net(x) - x.sum(dim=1, keepdim=True)).square().mean().backward()
        optimiser.step()


@pytest.mark.parametrize("eps", [1e-8, 1e-2])
def test_it_is_torchs_adam(eps):
    ours, theirs = network(), network()
    one, other = (
        Adam(ours.parameters(), lr=1e-2, eps=eps),
        torch.optim.Adam(theirs.parameters(), lr=1e-2, eps=eps),
    )
    descend(ours, one, 100)
    descend(theirs, other, 100)
    for p, q in zip(ours.parameters(), theirs.parameters(), strict=True):
        assert torch.allclose(p, q, rtol=1e-4, atol=1e-5)


def test_a_loaded_state_goes_on_alike():
    one, other = network(), network()
    first, second = Adam(one.parameters()), Adam(other.parameters())
    descend(one, first, 5)
    other.load_state_dict(one.state_dict())
    second.load_state_dict(first.state_dict())
    descend(one, first, 5, seed=2)
    descend(other, second, 5, seed=2)
    for p, q in zip(one.parameters(), other.parameters(), strict=True):
        assert torch.equal(p, q)


def test_a_state_of_other_parameters_is_refused():
    with pytest.raises(ValueError, match="other parameters"):
        Adam(network().parameters()).load_state_dict(Adam(torch.nn.Linear(2, 2).parameters()).state_dict())


def test_a_parameter_without_a_gradient_is_an_error():
    with pytest.raises(RuntimeError, match="no gradient"):
        Adam(network().parameters()).step()


def test_a_learner_starts_without_torchs_compiler():
    program = """
import sys
import numpy as np
from babble.encoder.network import Encoder
from babble.encoder.training import EncoderTrainer
from babble.memory import ExperienceMemory
from babble.policy.ppo import GoalPPO

memory = ExperienceMemory()
memory.extend("a", np.random.default_rng(0).standard_normal((9, 2, 3)), np.zeros((9, 2)))
trainer = EncoderTrainer(Encoder(3, 2), learning_rate=1e-3, batch=4)
trainer.begin_fit(3, 0.3)
trainer.update(memory, 1)
ppo = GoalPPO(2, 3, steps=4, columns=2)
frame = {"latent": (4, 2, 2), "next_latent": (4, 2, 2), "goal": (4, 2, 2), "action": (4, 2, 3)}
rollout = {name: np.zeros(shape) for name, shape in frame.items()}
ppo.update(rollout | {name: np.zeros((4, 2)) for name in ("log_prob", "truncated", "terminated")})
assert "torch._dynamo" not in sys.modules
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
