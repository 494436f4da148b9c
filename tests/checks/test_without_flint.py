"""Without python-flint, modules of tests that need it are skipped, and others are not."""

import pytest

from helpers.without_flint import SkippedModule

NO_FLINT = "raise ModuleNotFoundError(\"No module named 'flint'\")"


@pytest.mark.parametrize(
    ("line", "error"),
    [
        (NO_FLINT, pytest.skip.Exception),
        ("raise SystemExit(2)", pytest.skip.Exception),  # as the checker of proofs ends
        ("raise ImportError('another')", pytest.Collector.CollectError),
    ],
)
def test_modules_that_need_flint_are_skipped(line, error, request, tmp_path):
    path = tmp_path / "test_module_without_flint.py"
    path.write_text(line)
    module = SkippedModule.from_parent(request.node.getparent(pytest.Module).parent, path=path)
    with pytest.raises(error):
        module.collect()
