// Makes the TypeScript of the wire, `src/wire`, from the project's proto files.

import { execFileSync } from 'node:child_process';

// buf's program for this machine, without the package that chooses one: that names packages not every registry has.
const machine = { x64: 'x64', arm64: 'aarch64' }[process.arch];
const program = `node_modules/@bufbuild/buf-${process.platform}-${machine}/bin/buf`;
execFileSync(program, ['generate', '../../proto', '--template', 'buf.gen.yaml'], { stdio: 'inherit' });
