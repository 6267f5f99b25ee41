"""Both benchmarks of staggered rigs: `python -m benchmarks.stagger`; each has options of its own."""

from benchmarks.stagger import ball_path, rig_errors

if __name__ == "__main__":
    ball_path.main()
    print()
    rig_errors.main()
