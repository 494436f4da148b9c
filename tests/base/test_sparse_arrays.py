"""The suite refuses what a newer SciPy warns of, wherever our code does it: see helpers/sparse_arrays.py."""

import cvxpy as cp
import numpy as np
import pytest
import scipy.sparse as sp
from scipy.io import loadmat, savemat

DENSE, SPARSE = np.eye(2), sp.eye_array(2)


@pytest.mark.parametrize(
    "make",
    [
        lambda: sp.csc_matrix(DENSE),
        lambda: sp.eye(2),
        lambda: sp.diags([1.0, 2.0]),
        lambda: sp.block_diag([DENSE, DENSE]),
        lambda: sp.block_diag([DENSE, DENSE], format="csr"),
        lambda: sp.kron(DENSE, DENSE),
    ],
)
def test_the_older_type_is_refused(make):
    with pytest.raises(DeprecationWarning):
        make()


def test_a_mat_file_is_read_into_sparse_arrays(tmp_path):
    savemat(tmp_path / "run.mat", {"x": sp.csc_array(DENSE)})
    with pytest.raises(DeprecationWarning):
        loadmat(tmp_path / "run.mat")
    assert isinstance(loadmat(tmp_path / "run.mat", spmatrix=False)["x"], sp.sparray)


def test_sparse_arrays_and_what_third_parties_make_pass():
    for made in (sp.block_diag([SPARSE, DENSE]), sp.kron(SPARSE, DENSE), sp.vstack([SPARSE, sp.csr_array(DENSE)])):
        assert isinstance(made, sp.sparray)
    assert isinstance(cp.Constant(sp.csc_array(DENSE)).value, sp.sparray | sp.spmatrix)
    x = cp.Variable(2)
    assert cp.Problem(cp.Minimize(cp.sum_squares(DENSE @ x - 1))).get_problem_data(cp.CLARABEL)[0]["A"].shape[1] >= 2
