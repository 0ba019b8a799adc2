#!/bin/sh
# Installs /mnt/locked/requirements.txt into /opt/babble, without what no process of Babble ever loads, and
# compiled, since nothing can be written in a running container.
set -eu
uv=/mnt/uv
export UV_NO_CACHE=1 UV_LINK_MODE=copy UV_PYTHON_DOWNLOADS=never UV_PYTHON=/opt/babble

[ -d /opt/babble ] || $uv venv --quiet --python "$(command -v python3)" /opt/babble
if [ -f /mnt/locked/torch.txt ]; then
    $uv pip install --quiet --index "$(cat /mnt/locked/torch-index)" --overrides /mnt/locked/overrides.txt \
        --requirements /mnt/locked/torch.txt
fi
$uv pip install --quiet --no-deps --requirements /mnt/locked/requirements.txt

cd /opt/babble/lib/python3*/site-packages
find . -type d -name tests -prune -exec rm -rf {} +
# A C library that the Python module does not use: it holds its own copy. And tools to convert models.
rm -rf onnxruntime/capi/libonnxruntime.so.* onnxruntime/datasets onnxruntime/quantization \
    onnxruntime/tools onnxruntime/transformers mujoco/doc mujoco/introspect mujoco/*_test.py
# PyOpenGL is loaded only where a world sees, so it is not worth its bytecode.
# Some packages ship templates that are no Python of this version.
python3 -m compileall -qq -j 0 -x "/OpenGL/" . || true
