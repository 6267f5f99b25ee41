"""Who is who in drawn scenes of several people, with detections that err as real ones do. Simulated.

Each kind of scene is drawn for three to eight cameras and two to five people. Beside it stand how many takes
have just the true individuals, changes of a person's number and persons too many, in a thousand true ones at
a time, missing joints, and how many known ones are within the stated error, which holds the detections' bias.
"""

from collections.abc import Sequence

from benchmarks.people.scenes import KINDS, MIRROR_FOR_ALL, draw_take, locate_people
from benchmarks.people.scores import Scores, score
from benchmarks.report import Columns, Report, new_parser, print_report, print_rows

RIGS = (3, 4, 5, 8)
COLUMNS: Columns = {
    "kind": ("scenes", ""),
    "takes": ("takes", "d"),
    "takes_right": ("right", ".0%"),
    "true": ("individuals", "d"),
    "found": ("found", "d"),
    "changes": ("changes of number, 1/1000", ".2f"),
    "extra": ("too many, 1/1000", ".2f"),
    "missing": ("missing joints", ".2%"),
    "within": ("within the error", ".1%"),
    "median": ("median, mm", ".0f"),
    "most": ("90 %, mm", ".0f"),
}


def measure(kind: str, cameras: int, seed: int, late: float = 0.0) -> Scores:
    """Return the scores of one scene."""
    scene = draw_take(kind, cameras, seed, late=late)
    return score(scene.truth, scene.visible, locate_people(scene))


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the scores of all kinds of scenes."""
    parser = new_parser(__doc__)
    parser.add_argument("--seeds", type=int, default=2, help="takes of each kind and rig (2)")
    parser.add_argument("--first", type=int, default=0, help="number of the first take (0)")
    parser.add_argument("--kinds", nargs="*", default=KINDS, help=", ".join((*KINDS, MIRROR_FOR_ALL)))
    parser.add_argument("--cameras", type=int, nargs="*", default=RIGS, help="numbers of cameras (3 4 5 8)")
    parser.add_argument("--late", type=float, default=0.0, help="delay of every second camera, frames (0)")
    options = parser.parse_args(arguments)
    rows, everything = list[dict[str, object]](), list[Scores]()
    for kind in options.kinds:
        scores = [
            measure(kind, cameras, seed, options.late)
            for cameras in options.cameras
            for seed in range(options.first, options.first + options.seeds)
        ]
        everything += scores
        rows.append({"kind": kind, "takes": len(scores), **_sum(scores).figures()})
    rows.append({"kind": "all", "takes": len(everything), **_sum(everything).figures()})
    report: Report = {
        "kind": "simulated",
        "seeds": options.seeds,
        "first": options.first,
        "late": options.late,
        "rows": rows,
    }
    print_report(report, lambda of: print_rows(of["rows"], COLUMNS), as_json=options.json)


def _sum(scores: Sequence[Scores]) -> Scores:
    total = scores[0]
    for one in scores[1:]:
        total = total + one
    return total


if __name__ == "__main__":
    main()
