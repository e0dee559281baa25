// A small office with a floor plan, people, doors, robots and routes, written as files for the command line.
//
// Invariant: nothing random that is not drawn from the seed; the same arguments give the same files.

import { mkdirSync, writeFileSync } from 'node:fs';
import { join } from 'node:path';

/** Monday 3 March 2025, midnight in London. */
export const START = Date.UTC(2025, 2, 3) / 1000;
const DAY = 86_400;

/** Numbers in [0, 1) that depend on the seed alone (mulberry32). */
export function draws(seed) {
    let state = seed >>> 0;
    return () => {
        state = (state + 0x6d2b79f5) >>> 0;
        let mixed = Math.imul(state ^ (state >>> 15), state | 1);
        mixed ^= mixed + Math.imul(mixed ^ (mixed >>> 7), mixed | 61);
        return ((mixed ^ (mixed >>> 14)) >>> 0) / 4_294_967_296;
    };
}

// The plan in metres: a corridor from west to east, rooms on both sides of it.
const WIDTH = 32;
const HEIGHT = 16.8;
const CORRIDOR = { south: 7, north: 9.8 };
export const ROOMS = [
    { name: 'office-1', west: 0, east: 6, north: true },
    { name: 'office-2', west: 6, east: 12, north: true },
    { name: 'office-3', west: 12, east: 18, north: true },
    { name: 'lab', west: 18, east: 32, north: true },
    { name: 'entrance', west: 0, east: 7, north: false },
    { name: 'meeting-room', west: 7, east: 15, north: false },
    { name: 'kitchen', west: 15, east: 24, north: false },
    { name: 'storage', west: 24, east: 32, north: false },
];

/** When a room is used: hours of the day, and how likely on a working day. */
const USE = {
    'office-1': [[8.5, 12, 0.9], [13, 17.5, 0.85]],
    'office-2': [[9, 12.5, 0.85], [13.5, 18, 0.8]],
    'office-3': [[7, 15, 0.8]],
    lab: [[9.5, 12, 0.7], [14, 18.5, 0.75]],
    entrance: [[8, 9.5, 0.6], [17, 18.5, 0.6]],
    'meeting-room': [[10, 11, 0.75], [15, 16, 0.4]],
    kitchen: [[8, 8.5, 0.3], [12, 13.2, 0.95], [15.5, 16, 0.5]],
    storage: [[7.5, 8, 0.2], [16, 17, 0.25]],
};

function isWorkday(day) {
    return day % 7 < 5;
}

/** Whether each room is in use at a time of a day; a day has its own shifts and absences. */
function dayOf(seed, day) {
    const draw = draws(seed * 1000 + day);
    const uses = {};
    for (const room of ROOMS) {
        uses[room.name] = [];
        for (const [from, to, likely] of USE[room.name]) {
            const shift = (draw() - 0.5) * 0.7;
            const happens = draw() < (isWorkday(day) ? likely : likely * 0.06);
            if (happens) uses[room.name].push([from + shift, to + shift + (draw() - 0.5) * 0.5]);
        }
    }
    return { uses, door: 8 + draw() * 0.7, close: 17.5 + draw(), seed: draw() };
}

const inUse = (day, name, hour) => day.uses[name].some(([from, to]) => hour >= from && hour < to);

/** The floor at a time, one byte a cell in rows from north to south: 0 occupied, 254 free, 205 unknown. */
function floor(day, hour, cell, draw) {
    const width = Math.round(WIDTH / cell);
    const height = Math.round(HEIGHT / cell);
    const cells = new Uint8Array(width * height).fill(254);
    const fill = (west, south, east, north, value) => {
        const x1 = Math.min(width, Math.round(east / cell));
        const y1 = Math.min(height, Math.round(north / cell));
        for (let y = Math.max(0, Math.round(south / cell)); y < y1; y++) {
            cells.fill(value, (height - 1 - y) * width + Math.max(0, Math.round(west / cell)), (height - 1 - y) * width + x1);
        }
    };
    const wall = 0.2;
    fill(0, 0, WIDTH, wall, 0);
    fill(0, HEIGHT - wall, WIDTH, HEIGHT, 0);
    fill(0, 0, wall, HEIGHT, 0);
    fill(WIDTH - wall, 0, WIDTH, HEIGHT, 0);
    fill(0, CORRIDOR.south - wall, WIDTH, CORRIDOR.south, 0);
    fill(0, CORRIDOR.north, WIDTH, CORRIDOR.north + wall, 0);
    for (const room of ROOMS) {
        const [south, north] = room.north ? [CORRIDOR.north, HEIGHT] : [0, CORRIDOR.south];
        fill(room.east - wall, south, room.east, north, 0);
        const middle = (room.west + room.east) / 2;
        const door = room.north ? CORRIDOR.north : CORRIDOR.south - wall;
        const isOpen = inUse(day, room.name, hour) || draw() < 0.04;
        fill(middle - 0.5, door, middle + 0.5, door + wall, isOpen ? 254 : 0);
        // Cupboards along the outer wall, desks, and whoever is there.
        const back = room.north ? north - 0.7 : 0.2;
        fill(room.west + 0.4, back, room.east - 0.4, back + 0.5, 0);
        const desks = Math.max(1, Math.floor((room.east - room.west) / 3));
        for (let desk = 0; desk < desks; desk++) {
            const x = room.west + ((desk + 0.5) * (room.east - room.west)) / desks;
            const y = room.north ? north - 3 : 2.4;
            fill(x - 0.8, y, x + 0.8, y + 0.8, 0);
            if (inUse(day, room.name, hour) && draw() < 0.8) {
                const px = x + (draw() - 0.5) * 1.6;
                const py = (room.north ? y - 0.9 : y + 1.5) + (draw() - 0.5) * 0.6;
                fill(px - 0.3, py - 0.3, px + 0.3, py + 0.3, 0);
            }
        }
    }
    // People in the corridor, and crates that stand there in the morning.
    const busy = isWorkday(Math.floor(day.number)) && hour > 7.5 && hour < 18.5 ? 5 : 0;
    for (let person = 0; person < busy; person++) {
        const x = 1 + draw() * (WIDTH - 2);
        const y = CORRIDOR.south + 0.5 + draw() * 1.6;
        fill(x - 0.25, y - 0.25, x + 0.25, y + 0.25, 0);
    }
    if (hour > 6 && hour < 9.5 && day.number % 7 === 0) fill(26, CORRIDOR.south + 1.6, 29, CORRIDOR.north - 0.2, 0);
    return { cells, width, height };
}

/** Writes the office into a folder. */
export function write(folder, { days = 14, cell = 0.1, scansPerDay = 24, seed = 1 } = {}) {
    mkdirSync(folder, { recursive: true });
    const draw = draws(seed + 77);
    const seen = ['time,state,value'];
    const runs = ['from,to,start,end,success,reason'];
    let scan = 0;
    for (let number = 0; number < days; number++) {
        const day = { ...dayOf(seed, number), number };
        const midnight = START + number * DAY;
        const readings = [];
        for (let second = 0; second < DAY; second += 600) {
            const hour = second / 3600;
            for (const room of ROOMS) {
                if (draw() < 0.4) readings.push([midnight + second + Math.floor(draw() * 500), room.name, inUse(day, room.name, hour)]);
            }
            if (draw() < 0.5) {
                const isOpen = isWorkday(number) && hour > day.door && hour < day.close;
                readings.push([midnight + second + Math.floor(draw() * 500), 'front-door', isOpen]);
            }
        }
        readings.sort((a, b) => a[0] - b[0]);
        for (const [time, state, value] of readings) seen.push(`${time},${state},${value ? 1 : 0}`);
        for (let second = 0; second < DAY; second += 1800) {
            const hour = second / 3600;
            const start = midnight + second + Math.floor(draw() * 900);
            const edge = EDGES[Math.floor(draw() * EDGES.length)];
            const [from, to] = draw() < 0.5 ? edge : [edge[1], edge[0]];
            const room = ROOMS.find((room) => room.name === from || room.name === to);
            const isOpen = !room || room.name === 'entrance' || inUse(day, room.name, hour) || draw() < 0.5;
            const secs = Math.round(lengthOf(from, to) / (hour > 8 && hour < 18 ? 0.4 : 0.6));
            runs.push(`${from},${to},${start},${start + secs},${isOpen},${isOpen ? '' : 'door closed'}`);
        }
        for (let at = 0; at < scansPerDay; at++) {
            const plan = floor(day, (at * 24) / scansPerDay, cell, draw);
            const name = join(folder, `scan-${String(scan++).padStart(5, '0')}`);
            writeFileSync(`${name}.pgm`, Buffer.concat([Buffer.from(`P5\n${plan.width} ${plan.height}\n255\n`), plan.cells]));
            writeFileSync(`${name}.yaml`,
                `image: ${name}.pgm\nresolution: ${cell}\norigin: [0.0, 0.0, 0.0]\nnegate: 0\n` +
                'occupied_thresh: 0.65\nfree_thresh: 0.196\n');
        }
    }
    writeFileSync(join(folder, 'seen.csv'), `${seen.join('\n')}\n`);
    writeFileSync(join(folder, 'runs.csv'), `${runs.join('\n')}\n`);
    return { scans: scan, every: DAY / scansPerDay, end: START + days * DAY };
}

/** Places: one in each room, and five along the corridor. */
export const NODES = [
    ...ROOMS.map((room) => ({
        name: room.name,
        pose: { xM: (room.west + room.east) / 2, yM: room.north ? CORRIDOR.north + 2.2 : CORRIDOR.south - 1.6 },
    })),
    ...[3, 9.5, 16, 22.5, 28.5].map((xM, index) => ({ name: `corridor-${index + 1}`, pose: { xM, yM: 8.4 } })),
];

function place(name) {
    return NODES.find((node) => node.name === name).pose;
}

function lengthOf(from, to) {
    return Math.hypot(place(from).xM - place(to).xM, place(from).yM - place(to).yM);
}

const EDGES = [
    ['corridor-1', 'corridor-2'], ['corridor-2', 'corridor-3'], ['corridor-3', 'corridor-4'], ['corridor-4', 'corridor-5'],
    ['entrance', 'corridor-1'], ['office-1', 'corridor-1'], ['office-2', 'corridor-2'], ['meeting-room', 'corridor-2'],
    ['office-3', 'corridor-3'], ['kitchen', 'corridor-3'], ['kitchen', 'corridor-4'], ['lab', 'corridor-4'],
    ['lab', 'corridor-5'], ['storage', 'corridor-5'],
];

/** The message of `LoadTopology`. */
export function topology(map) {
    const edges = EDGES.map(([from, to]) => ({ ends: { from, to, bothWays: true }, lengthM: lengthOf(from, to) }));
    return { map, nodes: NODES, edges };
}
