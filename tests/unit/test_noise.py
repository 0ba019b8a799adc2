import numpy as np
import pytest

from babble.noise import make_noise


def series(kind, *, steps=4096, columns=64, size=2, seed=0, **settings):
    noise = make_noise(
        kind, scale=0.6, columns=columns, size=size, rng=np.random.default_rng(seed), **settings
    )
    return np.stack([noise.sample() for _ in range(steps)])


def slope(values, low=2e-3, high=0.1):
    """The exponent of the power spectrum over frequency, in cycles per step."""
    frequency = np.fft.rfftfreq(len(values))
    power = (np.abs(np.fft.rfft(values, axis=0)) ** 2).reshape(len(frequency), -1).mean(axis=1)
    band = (frequency > low) & (frequency < high)
    return np.polyfit(np.log(frequency[band]), np.log(power[band]), 1)[0]


@pytest.mark.parametrize("kind", ["white", "pink", "ou", "held"])
def test_the_deviation_is_the_scale_from_the_first_step_on(kind):
    values = series(kind, steps=1, columns=4000)[0]
    assert values.dtype == np.float32
    assert values.shape == (4000, 2)
    assert values.std() == pytest.approx(0.6, rel=0.05)
    later = series(kind, steps=300, columns=4000)[-1]
    assert later.std() == pytest.approx(0.6, rel=0.05)
    assert abs(later.mean()) < 0.03


@pytest.mark.parametrize(("kind", "exponent"), [("white", 0.0), ("pink", -1.0)])
def test_the_colour_of_the_noise(kind, exponent):
    assert slope(series(kind)) == pytest.approx(exponent, abs=0.1)


def test_pink_noise_is_brown_nowhere_and_bounded():
    values = series("pink", steps=8192, columns=8)
    assert np.abs(values).max() < 6 * 0.6


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.9])
def test_ou_noise_forgets_at_its_correlation(correlation):
    values = series("ou", correlation=correlation).astype(np.float64)
    for lag in (1, 3):
        found = (values[lag:] * values[:-lag]).mean() / (values**2).mean()
        assert found == pytest.approx(correlation**lag, abs=0.02)


def test_held_noise_changes_every_hold_steps_and_not_in_all_columns_at_once():
    values = series("held", steps=200, hold_steps=10)
    changed = (values[1:] != values[:-1]).any(axis=2)
    for column in changed.T:
        assert set(np.diff(np.flatnonzero(column))) == {10}
    assert 0 < changed.mean(axis=1).max() < 0.5


@pytest.mark.parametrize("kind", ["white", "pink", "ou", "held"])
def test_the_seed_decides_and_columns_are_independent(kind):
    one, again, other = (series(kind, steps=50, columns=3, seed=seed) for seed in (5, 5, 6))
    np.testing.assert_array_equal(one, again)
    assert (one != other).any()
    together = series(kind, columns=2, size=1, steps=4096)[:, :, 0]
    assert abs(np.corrcoef(np.diff(together, axis=0).T)[0, 1]) < 0.1


@pytest.mark.parametrize(
    ("kind", "settings", "words"),
    [
        ("brown", {}, "there is no noise 'brown'; the kinds are white, pink, ou, held, coloured"),
        ("ou", {"correlation": 1.0}, "correlation"),
        ("held", {"hold_steps": 0}, "hold_steps"),
    ],
)
def test_noise_that_cannot_be_is_refused(kind, settings, words):
    with pytest.raises(ValueError, match=words):
        series(kind, **settings)
