"""Problems, results and runs as files, and as objects of CVXPY and python-control."""

from lin_freq_ocp.base import lazy_exports

# fmt: off
__all__, __getattr__ = lazy_exports(__name__, {
    "batch_files": "sweep_summary", "codec": "TableRecord",
    "problem_file": "INLINE_LIMIT init_problem_file problem_text template", "run_file": "dump_run",
    "problem_tables": "NORM_COSTS RECORDS SETS SPECTRUM problem_from_tables",
    "solution_files": "header load_solution save_csv save_mat save_solution",
    "summary": "certificate_summary comparison_summary failed_comparison_summary head result_summary to_json",
})
