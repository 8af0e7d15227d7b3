#!/usr/bin/env python3
"""Shows that `rangehound explore` finds faults in the protocol.

    python3 tools/mutations.py [--seeds 10000] [WORDS]

For each fault in tools/mutations.toml (those whose text has WORDS, if given): puts it into a copy of the sources, builds
that, and explores until it is found. Ends with 1 if one is not. Takes about half a minute for each; needs Python 3.11.
"""

import argparse
import pathlib
import shutil
import subprocess
import sys
import tomllib

ROOT = pathlib.Path(__file__).resolve().parent.parent
COPY = ROOT / "target" / "mutations"
MEMBERS = ["Cargo.toml", "Cargo.lock", "src", "shared", "sim", "robot", "fusion", "node", "gateway", "bench", "python", "fuzz", "scenarios", "tests", "README.md", "docs"]


def copy_sources():
    for name in MEMBERS:
        source, target = ROOT / name, COPY / name
        if source.is_dir():
            # Files that have gone from the sources must go from the copy too.
            shutil.rmtree(target, ignore_errors=True)
            shutil.copytree(source, target, ignore=shutil.ignore_patterns("target"))
        elif source.exists():
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source, target)


def explore(seeds):
    subprocess.run(["cargo", "build", "--quiet", "--profile", "test"], cwd=COPY, check=True)
    command = [COPY / "target" / "debug" / "rangehound", "explore", "--seed", "1", "--seeds", str(seeds)]
    return subprocess.run(command, cwd=COPY, capture_output=True, text=True, timeout=1800)


def main():
    arguments = argparse.ArgumentParser(description="Shows that `rangehound explore` finds faults in the protocol.")
    arguments.add_argument("--seeds", type=int, default=10_000, help="seeds in which a fault must be found")
    arguments.add_argument("words", nargs="?", default="", help="only faults whose text has these words")
    arguments = arguments.parse_args()
    mutations = tomllib.loads((ROOT / "tools" / "mutations.toml").read_text())["mutation"]
    mutations = [mutation for mutation in mutations if arguments.words in mutation["what"]]
    copy_sources()
    clean = explore(arguments.seeds)
    if clean.returncode != 0:
        sys.exit(f"without any fault: {clean.stderr.splitlines()[-1]}")
    missed = 0
    for mutation in mutations:
        path = COPY / mutation["file"]
        text = path.read_text()
        if text.count(mutation["from"]) != 1:
            sys.exit(f"{mutation['file']}: expected once: {mutation['from']}")
        path.write_text(text.replace(mutation["from"], mutation["to"]))
        try:
            found = explore(arguments.seeds)
        finally:
            path.write_text(text)
        lines = found.stderr.strip().splitlines()
        if found.returncode == 1 and lines:
            print(f"found   {mutation['what']}\n        {lines[-1]}", flush=True)
        else:
            missed += 1
            print(f"MISSED  {mutation['what']}", flush=True)
    print(f"{len(mutations) - missed} of {len(mutations)} faults found within {arguments.seeds} seeds")
    sys.exit(1 if missed else 0)


if __name__ == "__main__":
    main()
