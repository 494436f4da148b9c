"""Compare filtering afterwards with solving under the frequency constraint, and write the report.

    python scripts/compare_filter_vs_pmp.py pendulum --out report
    python scripts/compare_filter_vs_pmp.py my_problem.toml --set horizon=300 --filters brickwall,butterworth

Takes any library problem or problem file, and the options of `lin-freq-ocp compare`; without --out, writes ./report.
"""

import sys

from lin_freq_ocp.cli.app import main

if __name__ == "__main__":
    arguments = sys.argv[1:] or ["pendulum"]
    named = any(argument.startswith("--out") for argument in arguments)
    main(["compare", *arguments, *([] if named else ["--out", "report"])])
