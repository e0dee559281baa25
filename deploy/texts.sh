#!/usr/bin/env bash
# Completions and man pages of both programs, as the programs themselves write them.
#
#   deploy/texts.sh PROGRAMS DIR   PROGRAMS is the folder of tidemap and tidemapd; DIR gets bash, zsh, fish and man
set -euo pipefail
programs=$1
dir=$2
rm -rf "$dir"
mkdir -p "$dir"/{bash,zsh,fish,man}
for program in tidemap tidemapd; do
    "$programs/$program" completions bash >"$dir/bash/$program"
    "$programs/$program" completions zsh >"$dir/zsh/_$program"
    "$programs/$program" completions fish >"$dir/fish/$program.fish"
    "$programs/$program" man-pages "$dir/man"
done
