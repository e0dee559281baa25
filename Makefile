# tidemap. Every target does its own set-up on a fresh Debian or Ubuntu with git, make, a network and root or sudo;
# deploy/setup.sh says what it installs, and is silent where nothing is missing.

.DEFAULT_GOAL := help
.PHONY: help build texts schemathesis foxglove api-page palette web web-check demo cluster-demo test wheel python ros-test cpp-test docs lint sbom bench cluster-bench soak cluster-faults fuzz durability install deb clean
# The tests of `make durability`.
HARD := test(durability) or package(tidemap-store) or test(random_operations) or test(gateway::tests::forward) or \
	test(replica::tests)
# The recipes of this file share one cargo, and cargo has its own jobs.
.NOTPARALLEL:

SHELL := bash
.SHELLFLAGS := -euo pipefail -c
SETUP := deploy/setup.sh
ENV := . target/setup.env
BUILT = $${CARGO_TARGET_DIR:-target}/release
PREFIX ?= /usr/local
SCHEMATHESIS := 4.32.5
WEBSOCKETS := 17.4
# What the tests need, as one build: the libraries, every program (with the daemon that has a planted fault) and every
# test. The runner then finds all of it built.
TESTED = --workspace --locked --bins --tests $(FEATURES)
# Parts that few users need: clusters, traces, Foxglove. Installed and packaged programs have them.
FULL := --features tidemapd/full,tidemap/full
EXTRA :=
# All but the allocator, whose C code takes as long to build as a crate of the daemon.
FEATURES := --no-default-features --features tidemapd/traces

## help: the targets of this file
help:
	@sed -n 's/^## \([a-z-]*\): /  make \1\t/p' Makefile | expand -t 22

## build: the daemon, the command line and the load generator, optimised; without clusters, traces and Foxglove
build:
	@$(SETUP)
	@$(ENV); cargo build --release --locked -p tidemapd -p tidemap -p tidemap-bench $(EXTRA)

## web: the page, from client/web into client/web/dist, which the daemon embeds; needs Node
web:
	@$(SETUP) web
	@$(ENV); cd client/web && npm ci --no-audit --no-fund --loglevel error && npm run -s build

## schemathesis: calls the JSON interface with generated requests; SECONDS_MAX=n, SEED=n; needs Python 3.10
schemathesis: build
	@[ -x target/schemathesis/bin/schemathesis ] || { python3 -m venv target/schemathesis && \
		target/schemathesis/bin/pip install --quiet schemathesis==$(SCHEMATHESIS); }
	@tests/schemathesis/run.sh "$(BUILT)" "$$PWD/target/schemathesis"

## foxglove: asks `tidemap foxglove` by the protocol of Foxglove; needs Python 3.10
foxglove:
	@$(SETUP)
	@$(ENV); cargo build --locked -p tidemapd -p tidemap $(FEATURES),tidemap/foxglove
	@[ -x target/foxglove/bin/python ] || { rm -rf target/foxglove.new && python3 -m venv target/foxglove.new && \
		target/foxglove.new/bin/python -m pip install --quiet websockets==$(WEBSOCKETS) && \
		mv target/foxglove.new target/foxglove; }
	@target/foxglove/bin/python tests/foxglove/check.py "$${CARGO_TARGET_DIR:-target}/debug"

## api-page: docs/src/api.md, from the descriptors of the wire; a test holds it equal
api-page:
	@$(ENV); TIDEMAP_WRITE_API_PAGE=1 cargo test --quiet -p tidemap-web --lib api_page

## guide-outputs: writes what the commands of README.md and docs/src show today; read the difference before you keep it
guide-outputs:
	@$(ENV); cargo build --workspace --locked $(FEATURES) && \
		TIDEMAP_WRITE_OUTPUTS=1 cargo test --quiet --workspace --locked $(FEATURES) --test integration examples

## palette: client/web/src/lib/palette.ts, from server/picture/src/palette.rs; a test holds it equal
palette:
	@$(ENV); TIDEMAP_WRITE_PALETTE=1 cargo test --quiet -p tidemap-picture --lib palette

## web-check: whether client/web/dist is what its source builds to
web-check: web
	@git diff --exit-code --stat -- client/web/dist && [ -z "$$(git status --porcelain -- client/web/dist)" ] || \
		{ echo "client/web/dist is not what client/web builds to: run make web, and commit client/web/dist" >&2; exit 1; }

## demo: a simulated office, weeks of robots' observations, and what is learned from them
# Without the allocator, clusters and traces, which it does not need.
demo:
	@$(SETUP)
	@$(ENV); cargo build --profile demo --no-default-features --locked -p tidemapd -p tidemap
	@$${CARGO_TARGET_DIR:-target}/demo/tidemap demo $(ARGS)

## cluster-demo: three daemons hold one map; the one that writes it is killed while robots send, and nothing is lost
cluster-demo:
	@$(SETUP) cluster
	@$(ENV); cargo build --profile demo --no-default-features --features tidemapd/cluster --locked -p tidemapd -p tidemap
	@$(ENV); python3 deploy/cluster_demo.py $${CARGO_TARGET_DIR:-target}/demo

## test: all tests
test:
	@$(SETUP) test
	@$(ENV); cargo build $(TESTED)
	@$(ENV); if [ "$$NEXTEST" = yes ]; then \
		cargo nextest run $(TESTED); \
	else \
		cargo test $(TESTED); \
	fi
	@$(ENV); cargo test --workspace --doc --locked $(FEATURES)
	@$(ENV); if [ -e client/web/node_modules/vite ]; then \
		cd client/web && npm run -s test; \
	else \
		echo "SKIPPED: the tests of client/web/src; client/web/node_modules is not installed: npm ci" >&2; \
	fi

## wheel: the Python wheel with the daemon in it, for glibc 2.28 and later, in target/wheels
wheel:
	@$(SETUP) python
	@$(ENV); deploy/wheel.sh

## python: the wheel, and its tests with each of PYTHONS (default: python3)
python: wheel
	@$(ENV); deploy/python.sh $(PYTHONS)

## ros-test: the wheel, and the package for ROS with real ROS 2 (DISTRO=kilted, or jazzy) and a real daemon
ros-test: wheel
	@$(ENV); cargo build --locked $(FEATURES) -p tidemapd -p tidemap --bins
	@$(ENV); deploy/ros_test.sh $(or $(DISTRO),kilted)

## cpp-test: builds the examples of client/cpp (queue, and wire with Debian's gRPC) and runs them with a real daemon
cpp-test:
	@$(SETUP) cpp
	@$(ENV); cargo build --locked $(FEATURES) -p tidemapd -p tidemap --bins
	@$(ENV); deploy/cpp_test.sh "$${CARGO_TARGET_DIR:-target}/debug/tidemapd"

## docs: the guide, as pages of HTML in target/docs
docs:
	@$(SETUP) docs
	@$(ENV); target/tools/bin/mdbook build docs

## lint: formatting, lints, and the policy on dependencies (deny.toml)
lint:
	@$(SETUP) lint
	@$(ENV); cargo fmt --all --check
	@$(ENV); cargo clippy --workspace --all-targets $(FEATURES),tidemap-store/fuzz --locked -- -D warnings
	@$(ENV); deploy/check-dependencies.sh

## sbom: the programs' dependencies with versions, licences and hashes, as CycloneDX in target/sbom
sbom:
	@$(SETUP)
	@$(ENV); python3 deploy/sbom.py target/sbom

## bench: the benchmarks of the libraries
bench:
	@$(SETUP)
	@$(ENV); cargo bench --workspace --locked --benches $(ARGS)

## soak: the tests of durability for HOURS hours (default 1), each time with new seeds; counts stay in target/soak
soak:
	@$(SETUP) test
	@$(ENV); python3 deploy/soak.py $(or $(HOURS),1) $(ROWS)

## cluster-bench: measures a cluster of three engines and three daemons on this machine; FIGURES="lag moves" for some
cluster-bench:
	@$(SETUP) cluster
	@$(ENV); cargo build --release --locked -p tidemapd -p tidemap -p tidemap-bench $(FULL)
	@$(ENV); python3 deploy/cluster_bench.py "$(BUILT)" $(FIGURES)

## cluster-faults: harms a cluster in network namespaces with CLUSTER_FAULTS faults (300); SEED=n; can be resumed; root
cluster-faults: export CLUSTER_FAULTS ?= 300
cluster-faults:
	@$(SETUP) cluster
	@$(ENV); cargo build --release --locked $(FEATURES),tidemapd/cluster -p tidemapd -p tidemap -p tidemap-tests --bins
	@$(ENV); python3 deploy/cluster_faults.py "$(BUILT)" $(CLUSTER_FAULTS) $(or $(SEED),1) $(KINDS)

## fuzz: any bytes for the readers of the wire, of CSV and of every file, SECS seconds each (default 60)
fuzz:
	@$(SETUP) fuzz
	@$(ENV); deploy/fuzz.sh $(or $(SECS),60) $(TARGETS)

## durability: many rounds of kill -9, power cuts and damage against the real daemon, and of faults of a simulated disk
durability: export TIDEMAP_KILL_ROUNDS ?= 100
durability: export TIDEMAP_POWERCUT_ROUNDS ?= 60
durability: export TIDEMAP_FLIPS ?= 1000
durability: export TIDEMAP_HARMS ?= 500
durability: export TIDEMAP_CALL_KILLS ?= 300
durability: export TIDEMAP_FULL_ROUNDS ?= 100
durability: export TIDEMAP_ERASURE_KILLS ?= 20
durability: export TIDEMAP_SIMULATED_SEEDS ?= 5000
durability: export TIDEMAP_CLUSTER_SEEDS ?= 2500
durability: export TIDEMAP_OPERATIONS ?= 20000
durability: export TIDEMAP_TOKEN_READS ?= 100000
durability: export TIDEMAP_FULL := 1
# With what ships.
durability: FEATURES := $(FULL)
durability:
	@$(SETUP) test
	@$(ENV); cargo build --release $(TESTED)
	@$(ENV); if [ "$$NEXTEST" = yes ]; then \
		cargo nextest run --release $(TESTED) --profile durability -E "$(HARD)"; \
	else \
		cargo test --release $(TESTED) -- --nocapture --test-threads 1 durability simulation tests:: random_operations; \
	fi

# Completions and man pages, which both programs write themselves.
install texts deb schemathesis: EXTRA := $(FULL)
texts: build
	@deploy/texts.sh "$(BUILT)" target/texts

## install: the programs, completions and man pages, into PREFIX (default /usr/local)
install: texts
	@dir="$(DESTDIR)$(PREFIX)"; sudo=; \
		if ! mkdir -p "$$dir/bin" 2>/dev/null || ! [ -w "$$dir/bin" ]; then sudo=sudo; fi; \
		$$sudo install -D -s -m 755 -t "$$dir/bin" "$(BUILT)/tidemapd" "$(BUILT)/tidemap" "$(BUILT)/tidemap-bench"; \
		$$sudo install -D -m 644 -t "$$dir/share/man/man1" target/texts/man/*; \
		$$sudo install -D -m 644 -t "$$dir/share/bash-completion/completions" target/texts/bash/*; \
		$$sudo install -D -m 644 -t "$$dir/share/zsh/site-functions" target/texts/zsh/*; \
		$$sudo install -D -m 644 -t "$$dir/share/fish/vendor_completions.d" target/texts/fish/*

## deb: the Debian package of the programs, in target/deb
deb: build
	@$(SETUP) deb
	@$(ENV); deploy/deb.sh "$(BUILT)"

## clean: removes what was built
clean:
	@rm -rf target
