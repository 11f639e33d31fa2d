"""The comparison of low-level options from run folders made by hand, and its bad input."""

import dataclasses

import pytest

from eihrl_jax import base
from eihrl_jax.config import changes, codec, presets
from eihrl_jax.runs import policies
from eihrl_jax.studies import ablate_low

HEADER = "step,eval/along_mean,eval/along_std,eval/lateral_mean,eval/lateral_std,eval/falls"


def _finished(config, name, seed, *rows):
    folder = config.out / name.replace(" ", "-") / f"seed-{seed}"
    meta = {"robot": "ant", "num_iterations": config.num_iterations}
    policies.save(folder / "policy", kind="low", params={}, meta=meta)
    restarting = dataclasses.replace(
        presets.low_restarting(),
        num_iterations=config.num_iterations,
        seed=seed,
        run=folder,
        resume=True,
    )
    trained = changes.apply(restarting, ablate_low.VARIANTS[name])
    (folder / "config.json").write_text(codec.to_json(trained))
    (folder / "metrics.csv").write_text("\n".join([HEADER, *rows]) + "\n")


def test_finished_runs_are_compared(tmp_path):
    config = ablate_low.AblationConfig(out=tmp_path, seeds=(0, 1), variants=("restarted steps",))
    _finished(config, "restarted steps", 0, "500,1.0,0.3,0.0,0.4,9", "1000,3.0,0.3,0.0,0.4,2")
    _finished(config, "restarted steps", 1, "500,1.0,0.3,0.0,0.4,9", "1000,2.0,0.0,0.0,0.0,4")
    _finished(config, "world frame", 0, "500,0.0,0.0,0.0,0.0,0")
    ablate_low.main(config)
    lines = (tmp_path / "table.md").read_text().splitlines()
    # sqrt(0.3² + 0.4²) = 0.5 in one run, 1 in the other.
    assert lines[2] == (
        "| restarted steps | 2 | 0.75 ± 0.35 | 2.50 ± 0.71 "
        "| 0.15 ± 0.21 | 0.20 ± 0.28 | 3.00 ± 1.41 |"
    )
    assert lines[3] == "| world frame | 1 | 3.00 | 0.00 | 0.00 | 0.00 | 0.00 |"
    assert (tmp_path / "curves.png").stat().st_size > 10_000
    curve = ablate_low.error_curve(tmp_path / "restarted-steps" / "seed-0" / "metrics.csv")
    assert curve[:, 0].tolist() == [4000.0, 8000.0]


def test_runs_of_another_budget_are_not_mixed_in(tmp_path):
    config = ablate_low.AblationConfig(out=tmp_path, seeds=(0,), variants=("restarted steps",))
    _finished(config, "restarted steps", 0, "500,1.0,0.3,0.0,0.4,9")
    with pytest.raises(base.UserError, match="was trained with other options"):
        ablate_low.main(dataclasses.replace(config, num_iterations=500))


def test_every_variant_but_the_first_changes_something_and_one_is_the_preset():
    restarting = presets.low_restarting()
    for name, options in ablate_low.VARIANTS.items():
        changed = changes.apply(restarting, options)
        assert (changed == restarting) == (name == "restarted steps")
        assert (changed == presets.low_best()) == name.startswith("best")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"variants": ("worse",)}, "variants = 'worse' must be one of restarted steps, "),
        ({"variants": ()}, "variants is empty"),
        ({"seeds": (1, 1)}, "seeds names 1 more than once"),
        ({"num_iterations": 750}, "evaluate_every = 500 must divide num_iterations = 750"),
    ],
)
def test_wrong_options_are_named(options, message):
    with pytest.raises(base.UserError, match=message):
        ablate_low.AblationConfig(**options)
