# Everything lives in .venv of this clone; its versions are those of constraints.txt.
SHELL := /bin/bash
BIN := .venv/bin
.DEFAULT_GOAL := help
.NOTPARALLEL:
.PHONY: help demo demo-identify demo-discrepancy demo-next test test-bench test-fast lint bench bench-real screenshots pictures \
        newcomers docs lock clean

# A ROS installation or another environment in the caller's shell must not leak in.
unexport PYTHONPATH PYTHONHOME LD_LIBRARY_PATH AMENT_PREFIX_PATH COLCON_PREFIX_PATH
unexport RMW_IMPLEMENTATION VIRTUAL_ENV _ROS_WHEELS_BOOTSTRAP_COMPLETE
export PIP_DISABLE_PIP_VERSION_CHECK := 1
# containers often forbid bytecode: each process would compile all of numba's sources, for 2 s
unexport PYTHONDONTWRITEBYTECODE
# rclpy refuses to start where it cannot write logs, as in a home that is missing or read-only
export ROS_LOG_DIR ?= $(CURDIR)/.venv/ros_log

help:  ## Show this list
	@sed -n 's/^\([a-z-]*\):.*## /  make \1\t/p' Makefile | expand -t 24

demo: .venv/.with-ros  ## Run the paper's experiment over ROS 2 into demo_output/
	@$(BIN)/gms_flex demo --out demo_output

demo-identify: .venv/.with-ros  ## Run identification over ROS 2 into demo_identify_output/
	@$(BIN)/python -m bench demo-identify --out demo_identify_output

demo-discrepancy: .venv/.with-ros  ## Hide an effect, find it and drive with it known, over ROS 2
	@$(BIN)/python -m bench demo-discrepancy --out demo_discrepancy_output

demo-next: .venv/.with-ros  ## Leave two names, design and drive the motion that leaves one, over ROS 2
	@$(BIN)/python -m bench demo-next --out demo_next_output

test: lint  ## Run the linters, the tests and a colcon build
	@$(BIN)/python -m pytest -n 3 --dist loadfile --no-loadscope-reorder

test-bench: .venv/.with-test  ## Run the tests of the bench, with its demos over ROS 2
	@$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder bench/test

test-fast: .venv/.with-test  ## Run the tests without nodes, browser and long fits, in a minute
	@$(BIN)/python -m pytest -q -n 2 --fast

lint: .venv/.with-test  ## Run ruff (the ament linters run among the tests)
	@$(BIN)/ruff check .

bench: .venv/.with-bench  ## Measure speed, beside MuJoCo
	@$(BIN)/python -m bench speed

bench-real: .venv/.with-bench  ## Run on real machines, beside least squares, write docs/real_machines.md
	@$(BIN)/python -m bench real-machines --out bench_real_output --docs

screenshots: .venv/.with-test  ## Make the pictures of docs/view.md anew (needs chromium)
	@PYTHONPATH=test:. $(BIN)/python scripts/screenshots.py

pictures: .venv/.with-test  ## Make the other pictures of README and docs anew (needs chromium)
	@PYTHONPATH=test:. $(BIN)/python scripts/pictures.py

newcomers: .venv/.with-test  ## Follow the tutorials in fresh clones, write docs/newcomers.md
	@PYTHONPATH=test:. $(BIN)/python scripts/newcomers.py

docs: .venv/.with-docs  ## Make the documentation site in docs/_build/html
	@$(BIN)/python scripts/draw_architecture.py
	@$(BIN)/python -m sphinx -q -b html -d docs/_build/doctrees docs docs/_build/html
	@echo "docs/_build/html/index.html"

lock: .venv/.created  ## Write constraints.txt anew from the newest versions setup.py allows
	@$(BIN)/python -m pip install --quiet uv
	@echo pip | $(BIN)/uv pip compile --quiet --universal --python-version 3.11 --all-extras \
	  --strip-extras --no-annotate --upgrade --custom-compile-command 'make lock' \
	  --output-file constraints.txt setup.py -

clean:  ## Remove the environment and all that was made
	rm -rf .venv docs/_api docs/_build demo_output demo_identify_output demo_discrepancy_output demo_next_output bench_real_output build install log .pytest_cache .ruff_cache *.egg-info

# A new lock starts a new environment, so that nothing of the old one stays.
.venv/.created: constraints.txt scripts/create_venv.sh
	@scripts/create_venv.sh
	@touch $@

# pip writes the console scripts into .venv/bin (setup.cfg's directories are colcon's), and
# an editable installation runs the sources of this clone.
.venv/.with-%: .venv/.created setup.py setup.cfg package.xml
	@echo "Installing gms_flex_control for '$*' into .venv (once; downloads up to 250 MB)"
	@$(BIN)/python -m pip install -qq --no-compile --no-build-isolation --use-pep517 \
	  -c constraints.txt --editable '.[ros,$*]'
	@touch $@
