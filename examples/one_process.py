"""The first half of the Composer in one process, without any wire: babble, encode, ground, score.

    python examples/one_process.py

Some ten seconds after torch is loaded it prints where the two goals lead. For experiments with the
encoder or the policy this is the place to start; nothing here knows of processes.
"""

import numpy as np

from babble.control import ground, walk
from babble.encoder.export import export_encoder
from babble.encoder.network import Encoder
from babble.encoder.training import EncoderTrainer
from babble.noise import make_noise
from babble.policy.act import EncoderModel
from babble.policy.goals import GoalClock
from babble.policy.ppo import GoalPPO
from babble.scores import score, walk_legs
from babble.worlds import make

COLUMNS, LATENT_DIM = 16, 2


def main(encoder_updates: int = 800, policy_steps: int = 32_768) -> dict[str, object]:
    """Returns the scores of the trained pair in a fresh world."""
    rng = np.random.default_rng(0)
    world = make("Cuboid", {}, columns=COLUMNS, seed=0)

    memory = walk(world, make_noise("ou", scale=0.6, columns=COLUMNS, size=3, rng=rng), steps=20_000)

    mean, scale = memory.scaling()
    trainer = EncoderTrainer(
        Encoder(world.senses, LATENT_DIM, mean=mean, scale=scale, seed=0),
        learning_rate=1e-3,
        batch=128,
    )
    trainer.begin_fit(window_steps=30, temperature=0.3)
    print("encoder:", trainer.update(memory, encoder_updates))
    trainer.end_fit()

    encoder = EncoderModel(export_encoder(trainer.encoder))
    learner = GoalPPO(LATENT_DIM, world.action_size, columns=COLUMNS)
    policy = ground(world, encoder, learner, GoalClock(COLUMNS, LATENT_DIM, 100, rng), rng, policy_steps)

    fresh = make("Cuboid", {}, columns=COLUMNS, seed=1)
    legs = walk_legs(fresh, encoder, policy, rng, legs=5, leg_steps=100)
    for goal in range(LATENT_DIM):
        print(f"goal {goal} leads to", legs.posture[legs.goal == goal].mean(axis=0).round(2))
    scores = dict(score(legs, fresh.diameter))
    print(scores)
    return scores


if __name__ == "__main__":
    main()
