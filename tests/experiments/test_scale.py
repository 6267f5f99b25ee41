"""`experiment scale`: figures of a leader beside a tree, the same in one process and in two."""

from pathlib import Path

from click.testing import CliRunner

from capture_app.experiments.scale.experiment import ScaleOptions, run


def test_one_leader_beside_a_tree(tmp_path: Path) -> None:
    talk: list[str] = []
    one, two = (
        run(
            trials=1,
            seed=2,
            talk=talk.append,
            options=ScaleOptions(sizes=(6,), minutes=1.2, jobs=jobs, shard_clients=3),
        )
        for jobs in (1, 2)
    )
    tree, alone = one.result.ours["6"], one.result.baseline["one_leader"]["6"]
    assert (tree["relays"], alone["relays"]) == (2, 0)
    for figures in (tree, alone):
        assert figures["coverage_hard_bound"] == 1.0
        assert 0.0 < figures["pair_error_us"]["median"] < figures["pair_error_us"]["p99"] < 400.0
    assert tree["leader_messages_per_s"] > 0.0 < tree["relay_messages_per_s"]
    assert len(talk) == 4
    assert one.draw is not None
    assert [path.read_bytes()[1:4] for path in one.draw(tmp_path)] == [b"PNG"]
    again = two.result.ours["6"]
    assert (again["digest"], again["pair_error_us"]) == (tree["digest"], tree["pair_error_us"])
    assert len(tree["pair_error_us"]["p99_by_minute"]) == 2


def test_help_names_the_full_size() -> None:
    from capture_app.commands.experiment import experiment

    shown = CliRunner().invoke(experiment, ["scale", "--help"])
    assert shown.exit_code == 0
    assert "--full" in shown.output
