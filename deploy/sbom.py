#!/usr/bin/env python3
"""Writes a list of all dependencies of each program as CycloneDX 1.5, from Cargo.lock by `cargo metadata`.

It lists the packages that are built into a program or run while it is built, on the platforms of deny.toml, and not those
that only tests use. It uses the data in the manifests of the packages; it does not search their sources for copied code or
other licences.

Usage: sbom.py FOLDER
"""

import json
import pathlib
import re
import subprocess
import sys
import tomllib

PROGRAMS = ("tidemapd", "tidemap")
PLATFORMS = ("x86_64-unknown-linux-gnu", "aarch64-unknown-linux-gnu")


def metadata():
    filters = [word for platform in PLATFORMS for word in ("--filter-platform", platform)]
    features = ("--features", "tidemapd/full,tidemap/full")
    command = ["cargo", "metadata", "--locked", "--format-version", "1", *features, *filters]
    return json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)


def reachable(nodes, root):
    """The packages that a program needs, and the edges between them, without those of tests."""
    edges, waiting = {}, [root]
    while waiting:
        package = waiting.pop()
        if package in edges:
            continue
        needed = [
            dependency["pkg"]
            for dependency in nodes[package]["deps"]
            if any(kind["kind"] != "dev" for kind in dependency["dep_kinds"])
        ]
        edges[package] = sorted(set(needed))
        waiting.extend(needed)
    return edges


def reference(package):
    return f"pkg:cargo/{package['name']}@{package['version']}"


def component(package, hashes, kind="library"):
    entry = {
        "type": kind,
        "bom-ref": reference(package),
        "name": package["name"],
        "version": package["version"],
        "purl": reference(package),
    }
    if package["license"]:
        # Old manifests separate alternatives by a slash.
        entry["licenses"] = [{"expression": re.sub(r"\s*/\s*", " OR ", package["license"])}]
    if package["description"]:
        entry["description"] = package["description"].strip()
    checksum = hashes.get((package["name"], package["version"]))
    if checksum:
        entry["hashes"] = [{"alg": "SHA-256", "content": checksum}]
    if package["repository"]:
        entry["externalReferences"] = [{"type": "vcs", "url": package["repository"]}]
    return entry


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    folder = pathlib.Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    found = metadata()
    packages = {package["id"]: package for package in found["packages"]}
    nodes = {node["id"]: node for node in found["resolve"]["nodes"]}
    lock = tomllib.loads(pathlib.Path("Cargo.lock").read_text(encoding="utf-8"))
    hashes = {(entry["name"], entry["version"]): entry.get("checksum") for entry in lock["package"]}
    for program in PROGRAMS:
        root = next(p["id"] for p in found["packages"] if p["name"] == program and p["source"] is None)
        edges = reachable(nodes, root)
        order = sorted(edges, key=lambda package: reference(packages[package]))
        bom = {
            "bomFormat": "CycloneDX",
            "specVersion": "1.5",
            "version": 1,
            "metadata": {"component": component(packages[root], hashes, "application")},
            "components": [component(packages[package], hashes) for package in order if package != root],
            "dependencies": [
                {
                    "ref": reference(packages[package]),
                    "dependsOn": sorted(reference(packages[needed]) for needed in edges[package]),
                }
                for package in order
            ],
        }
        path = folder / f"{program}.cdx.json"
        path.write_text(json.dumps(bom, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        print(f"{path}: {len(order) - 1} packages")


if __name__ == "__main__":
    main()
