#!/usr/bin/env bash
# The site, into docs/_build/html: warnings are errors, and nothing is loaded from a network.
set -euo pipefail
cd "$(dirname "$0")"

python=${PYTHON:-python3}
if [ -z "${PYTHON:-}" ] && [ -x ../.venv/bin/python ]; then python=../.venv/bin/python; fi
if ! "$python" -c 'import sphinx, sphinx_gallery, lin_freq_ocp' 2>/dev/null; then
  echo "docs/build.sh: $python lacks the extra \"docs\"; run: pip install -e '.[docs]'" >&2
  exit 2
fi
rm -rf api
"$python" -m sphinx --fail-on-warning --keep-going -q -b html . _build/html
"$python" check_links.py _build/html
echo "docs/_build/html/index.html"
