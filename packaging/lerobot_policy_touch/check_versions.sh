#!/usr/bin/env bash
# Runs check.py with two versions of LeRobot, each in an environment of its own below FOLDER (5 GB of
# downloads each), and writes its output to docs/results/lerobot_policy.txt:
#
#   packaging/lerobot_policy_touch/check_versions.sh FOLDER
set -euo pipefail
FOLDER=$(realpath -m "${1:?give a folder for the environments}")
cd "$(dirname "$0")"
ROOT=$(realpath ../..)
OUT="$ROOT/docs/results/lerobot_policy.txt"
LOG=$(mktemp)
trap 'rm -f "$LOG"' EXIT
while read -r python lerobot; do
  environment="$FOLDER/lerobot-$lerobot"
  if [ ! -e "$environment/ready" ]; then
    "$python" -m venv --clear "$environment"
    "$environment/bin/python" -m pip install --quiet "lerobot[training]==$lerobot"
    "$environment/bin/python" -m pip install --quiet --editable "$ROOT"
    "$environment/bin/python" -m pip install --quiet --no-deps --editable .
    touch "$environment/ready"
  fi
  rm -rf "$environment/check"
  OMP_NUM_THREADS=1 "$environment/bin/python" check.py "$environment/check" \
    > "$environment/output.txt" 2> "$environment/errors.txt" || { tail "$environment/errors.txt"; exit 1; }
  grep -E "^(yes|NO |lerobot)" "$environment/output.txt" >> "$LOG"
  echo >> "$LOG"
done << VERSIONS
python3.11 0.4.4
python3.12 0.6.1
VERSIONS
mv "$LOG" "$OUT"
cat "$OUT"
