# Daily work. `just` lists the recipes; each is one command that can be typed without just, too.

python := ".venv/bin/python"

_list:
    @just --list

# Make .venv with an editable install; run it again after a change in C++.
setup:
    test -x {{python}} || python3 -m venv .venv
    {{python}} -m pip install 'pip>=25.1'
    {{python}} -m pip install --config-settings cmake.define.PLAY_LAUNCH_FIXTURES=ON --config-settings cmake.define.PLAY_LAUNCH_WARNINGS_ARE_ERRORS=ON ./container_native --editable '.[jazzy,machines,parquet,top,web]' --group test

# Run the demo.
demo:
    .venv/bin/play-launch replay configs/demo.yaml

# Run all tests, on all processors.
test-all *arguments:
    {{python}} -m pytest -n auto --dist loadfile --durations 20 {{arguments}}

# Run what is named, one after the other: just test tests/supervisor -k restart
test *arguments:
    {{python}} -m pytest {{arguments}}

# Look for examples that break the property tests: just search tests/supervisor
search *arguments:
    {{python}} -m pytest --hypothesis-profile search {{arguments}}

# Run all tests but those of style with the lowest versions of the dependencies and extras that are permitted.
lowest:
    python3 -m venv build/lowest
    build/lowest/bin/pip install 'pip>=25.1'
    sed -n '/^dependencies/,/^\[dependency-groups/p' pyproject.toml | grep -oE '[a-z-]+>=[0-9.]+' | sed 's/>=/==/' > build/lowest.txt
    build/lowest/bin/pip install -c build/lowest.txt --config-settings cmake.define.PLAY_LAUNCH_FIXTURES=ON ./container_native '.[jazzy,machines,parquet,top,web]' --group test
    build/lowest/bin/pytest -n auto --dist loadfile --ignore tests/style

# Install the packages of the reader in JavaScript, which one test runs where they are.
readers:
    npm install --no-audit --no-fund --prefix tests/recording/topic_recorder/reader

# Simulate whole lives of systems until one breaks an invariant: just simulate --seeds 0:10000
simulate *arguments:
    {{python}} -m tests.simulation {{arguments}}

# Check style and types.
lint:
    {{python}} -m pytest tests/style

# Put C++ and Python into shape.
format:
    .venv/bin/clang-format -i $(git ls-files '*.cpp' '*.hpp')
    .venv/bin/ruff format .
    .venv/bin/ruff check --fix .

# Measure: just bench bring_up
bench name *arguments:
    {{python}} -m benchmarks.{{name}} {{arguments}}

# Make the pictures of the README and of docs/ anew (with Chromium).
pictures *arguments:
    {{python}} -m benchmarks.pictures {{arguments}}

# Patch ros2cli's own daemon: just patch-daemon --dry-run
patch-daemon *arguments:
    .venv/bin/play-launch daemon patch {{arguments}}

# Take that away again.
unpatch-daemon *arguments:
    .venv/bin/play-launch daemon unpatch {{arguments}}
