#!/bin/sh
# Writes for each image the packages that uv.lock names, with their digests: /locked/<image>/requirements.txt.
# With TORCH_INDEX set, torch and what only torch needs are left to that index, at the locked version.
set -eu

export_extra() {
    image=$1 extra=$2
    shift 2
    mkdir -p "/locked/$image"
    # Neither a window nor its renderer is ever opened.
    uv export --quiet --locked --no-dev --no-emit-project --no-annotate --no-header \
        --prune mujoco-studio --extra "$extra" "$@" >"/locked/$image/requirements.txt"
}

export_extra core coordinator
export_extra actor actor
export_extra dashboard dashboard
export_extra recorder recorder
export_extra tools launcher
if [ -z "${TORCH_INDEX:-}" ]; then
    export_extra learner learner
else
    export_extra learner learner --prune torch
    version=$(sed -n '/^name = "torch"$/{n;s/^version = "\(.*\)"$/\1/p;}' uv.lock)
    printf 'torch==%s\n' "$version" >/locked/learner/torch.txt
    printf '%s\n' "$TORCH_INDEX" >/locked/learner/torch-index
    # As pyproject.toml overrides it.
    printf "triton ; sys_platform == 'never'\n" >/locked/learner/overrides.txt
fi
