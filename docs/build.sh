#!/usr/bin/env bash
# The site, into docs/_build/html: warnings are errors, and nothing is loaded from a network.
#   bash docs/build.sh [TAG ...]    tags of git: their own pages, into docs/_build/html/TAG; every page lists them
set -euo pipefail
cd "$(dirname "$0")/.."

python=${PYTHON:-python3}
if [ -z "${PYTHON:-}" ] && [ -x .venv/bin/python ]; then python=$PWD/.venv/bin/python; fi
if ! PYTHONPATH=$PWD "$python" -c 'import sphinx, sphinx_gallery, lin_freq_ocp' 2>/dev/null; then
  echo "docs/build.sh: $python lacks the extra \"docs\"; run: pip install -e '.[docs]'" >&2
  exit 2
fi
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
site=$PWD/docs/_build/html

pages() { # of a tree, dated by a commit, with a tag or none, into a folder
  SOURCE_DATE_EPOCH=$(git log -1 --format=%ct "$2" 2>/dev/null || date +%s) DOCS_TAG=$3 DOCS_TAGS=$tags PYTHONPATH=$1 \
    "$python" -m sphinx --fail-on-warning --keep-going -q -b html "$1/docs" "$4"
}

tags=$*
for tag in "$@"; do
  mkdir -p "$work/$tag"
  git archive "$tag" | tar -x -C "$work/$tag"
  pages "$work/$tag" "$tag" "$tag" "$site/$tag"
done
rm -rf docs/api
pages "$PWD" HEAD "" "$site"
"$python" docs/check_links.py "$site"
echo "docs/_build/html/index.html"
