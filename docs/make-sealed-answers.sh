#!/bin/sh
# Make docs/sealed-answers.json with the released command alone:
#   cargo build --release && docs/make-sealed-answers.sh target/release/flexstage ../shared/data/sealed docs/sealed-answers.json
# Every session is diagnosed from its recordings and its rig file; nothing is edited afterwards.
set -eu
flexstage=$1
sealed=$2
answers=$3
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
for session in "$sealed"/s*/; do
    id=$(basename "$session")
    "$flexstage" diagnose --rig "$session/rig.toml" "$session" --out "$work/$id" >&2
done
python3 - "$work" > "$work/answers.json" <<'PY'
import json, pathlib, sys
answers = []
for folder in sorted(pathlib.Path(sys.argv[1]).iterdir()):
    if not folder.is_dir():
        continue
    d = json.loads((folder / "diagnosis.json").read_text())
    causes = [{"effect": c["effect"], "axes": c["axes"]} for c in d["causes"]]
    answers.append({"id": folder.name, "verdict": d["verdict"], "causes": causes})
print(json.dumps(answers, indent=2))
PY
mv "$work/answers.json" "$answers"
