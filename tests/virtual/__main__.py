"""Command line of virtual rigs: see `tests/virtual/__init__.py`."""

import argparse
import functools
import multiprocessing
import os
import sys
from collections.abc import Iterator

from tests.virtual.plan import Plan, draw
from tests.virtual.planted import FAULTS
from tests.virtual.run import Result, hunt, judged_together, run, run_seed


def _seeds(text: str) -> list[int]:
    first, _, last = text.partition("-")
    return list(range(int(first), int(last or first) + 1))


def shrink(plan: Plan, plant: str) -> tuple[Plan, list[int]]:
    """Return the plan with the fewest steps that still break something, and their numbers."""
    kept = list(range(len(plan.steps)))
    is_smaller = True
    while is_smaller:
        is_smaller = False
        for number in reversed(kept):
            fewer = [other for other in kept if other != number]
            if run(plan.only(fewer), FAULTS.get(plant)).failures:
                kept, is_smaller = fewer, True
    return plan.only(kept), kept


def _results(seeds: list[int], jobs: int, plant: str) -> Iterator[Result]:
    one = functools.partial(run_seed, plant=plant)
    if jobs == 1:
        yield from map(one, seeds)
        return
    # Processes of their own, fresh ones now and then: what one run leaves behind must not reach the next.
    with multiprocessing.get_context("spawn").Pool(jobs, maxtasksperchild=20) as pool:
        yield from pool.imap(one, seeds)


def main() -> int:
    """Run the command."""
    asks = argparse.ArgumentParser(prog="python -m tests.virtual")
    asks.add_argument("seeds", nargs="?", help="a seed, or a range as 0-299")
    asks.add_argument("--only", help="numbers of the plan's steps to keep, as 0,3,5")
    asks.add_argument("--shrink", action="store_true", help="search the fewest steps that still fail")
    asks.add_argument("--verbose", action="store_true", help="show the plan and the log")
    asks.add_argument(
        "--plant",
        choices=("all", *FAULTS),
        default="",
        help="put this fault into the product; without seeds: search the first seed that finds it, or each",
    )
    asks.add_argument("--first", action="store_true", help="stop at the first seed that fails")
    asks.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    asked = asks.parse_args()
    if asked.seeds is None:
        if not asked.plant:
            asks.error("give a seed, a range of seeds, or --plant")
        return _hunt(list(FAULTS) if asked.plant == "all" else [asked.plant], asked.jobs)
    seeds = _seeds(asked.seeds)
    return _one(seeds[0], asked) if len(seeds) == 1 else _many(seeds, asked)


def _hunt(names: list[str], jobs: int) -> int:
    """Search each planted fault, and print how it was found."""
    missed = 0
    with multiprocessing.get_context("spawn").Pool(min(jobs, len(names)), maxtasksperchild=1) as pool:
        for found in pool.imap(hunt, names):
            print(found, flush=True)
            missed += found.seed is None
    print(f"{len(names) - missed} of {len(names)} planted faults found")
    return bool(missed)


def _one(seed: int, asked: argparse.Namespace) -> int:
    only = [int(n) for n in asked.only.split(",") if n] if asked.only is not None else None
    plan = draw(seed).only(only)
    if asked.verbose:
        print(plan)
    if asked.shrink:
        plan, kept = shrink(plan, asked.plant)
        steps = ",".join(str(n if only is None else only[n]) for n in kept)
        print(f"python -m tests.virtual {seed} --only {steps} --verbose")
        print(plan)
    result = run(plan, FAULTS.get(asked.plant))
    if asked.verbose:
        for at_ns, machine, words in result.trace:
            print(f"{at_ns / 1e9:9.3f} {machine:6} {words}")
    print(result)
    return bool(result.failures)


def _many(seeds: list[int], asked: argparse.Namespace) -> int:
    failed = []
    done = 0
    cpu_s = virtual_s = 0.0
    for result in judged_together(_results(seeds, asked.jobs, asked.plant)):
        done, cpu_s, virtual_s = done + 1, cpu_s + result.cpu_s, virtual_s + result.virtual_s
        if result.failures or asked.verbose:
            print(result, flush=True)
        if result.failures:
            failed.append(result.seed)
            print(f"    replay: python -m tests.virtual {result.seed} --verbose", flush=True)
            if asked.first:
                break
    print(
        f"{done} seeds, {len(failed)} failed{': ' if failed else ''}{', '.join(map(str, failed))};"
        f" {cpu_s:.0f} CPU-s, {virtual_s / 60:.0f} virtual minutes"
    )
    return bool(failed)


if __name__ == "__main__":
    sys.exit(main())
