// Maps of the tests of the page, made by the command line as people make them.
//
// Invariant: files lie in the folder of the test, and no map is made twice.

import { writeFileSync } from 'node:fs';
import { join } from 'node:path';

/** Makes a map of 30 doors: each is open at an hour of its own, and door-13 was open in a night, too. */
export function doors(daemon, folder) {
    const rows = ['time,state,value'];
    const start = Date.UTC(2025, 1, 24);
    for (let slot = 0; slot < 18 * 48 + 47; slot++) {
        const [time, hour, day] = [new Date(start + slot * 1_800_000).toISOString(), (slot % 48) / 2, Math.floor(slot / 48)];
        for (let door = 0; door < 30; door++) {
            const isOpen = hour >= 5 + (door % 12) && hour < 9 + (door % 12);
            const isNight = door === 13 && day === 15 && hour < 5;
            rows.push(`${time},door-${String(door).padStart(2, '0')},${Number(isOpen || isNight)}`);
        }
    }
    const file = join(folder, 'doors.csv');
    writeFileSync(file, `${rows.join('\n')}\n`);
    daemon.run('map', 'create', 'doors', '--time-zone', 'UTC');
    daemon.run('observe', 'doors', file, '--producer', 'hub', '--nightly');
    daemon.run('update', 'doors');
}

/** Makes a map of a contact that reports changes, open from 9 to 17, and of a light barrier, with 4 events at 8. */
export function contacts(daemon, folder) {
    const [changes, events] = [['time,state,value'], ['time,state']];
    for (let day = 0; day < 22; day++) {
        const at = (hour, minute = 0) => new Date(Date.UTC(2025, 2, 3 + day, hour, minute)).toISOString();
        if (day % 7 < 5) changes.push(`${at(9)},contact,1`, `${at(17)},contact,0`);
        changes.push(`${at(12)},hub,1`);
        // The contact knows nothing from Thursday of the third week on, until Friday.
        if (day === 17) changes.push(`${at(12, 30)},contact,unavailable`);
        for (let event = 0; event < 4; event++) events.push(`${at(8, event * 10)},gate`);
    }
    const files = { changes, events };
    daemon.run('map', 'create', 'contacts', '--time-zone', 'UTC');
    for (const [kind, rows] of Object.entries(files)) {
        const file = join(folder, `${kind}.csv`);
        writeFileSync(file, `${rows.join('\n')}\n`);
        daemon.run('observe', 'contacts', file, '--producer', kind, `--${kind}`);
    }
    daemon.run('update', 'contacts');
}

/** Makes a map of places without positions, with an activity, tasks and the plan of a day, and a map of a robot's
 * position alone. */
export function works(daemon, folder) {
    const [activity, robot] = [['time,state,value'], ['time,state,x,y']];
    for (let slot = 0; slot < 10 * 48; slot++) {
        const [time, hour] = [new Date(Date.UTC(2025, 0, 4) + slot * 1_800_000).toISOString(), Math.floor((slot % 48) / 2)];
        activity.push(`${time},activity,${hour < 7 ? 'sleep' : hour === 12 ? 'eat' : 'work'}`);
        robot.push(`${time},robot,2,-1`);
    }
    daemon.run('map', 'create', 'depot', '--time-zone', 'UTC');
    daemon.run('state', 'add', 'depot', 'activity', '--kind', 'categorical', '--labels', 'sleep,eat,work');
    const files = { activity, robot, topology: ['node Hall', 'node Lab', 'link Hall Lab 15'] };
    const file = (name) => join(folder, `${name}.txt`);
    for (const [name, rows] of Object.entries(files)) writeFileSync(file(name), `${rows.join('\n')}\n`);
    daemon.run('topology', 'load', 'depot', file('topology'));
    daemon.run('observe', 'depot', file('activity'), '--producer', 'watch', '--kind', 'categorical');
    daemon.run('update', 'depot');
    daemon.run('map', 'create', 'yard', '--time-zone', 'UTC');
    daemon.run('observe', 'yard', file('robot'), '--producer', 'robot');
    daemon.run('update', 'yard');
    daemon.run('task', 'add', 'depot', 'charge', 'Hall', '--duration', '10m', '--value', '9');
    daemon.run('task', 'add', 'depot', 'inspect', 'Lab', '--from', '08:00', '--until', '18:00', '--duration', '20m', '--days', 'mon-fri');
    daemon.run('day', 'depot', '--date', '2025-01-14', '--tasks', '--keep');
}

/** Makes a map of a corridor where people walk from 7 to 19, east before noon and west after, and a map that has not
 * learned it. */
export function halls(daemon, folder) {
    const [people, heading] = [['time,state,x,y'], ['time,state,value']];
    for (let walk = 0; walk < 14 * 144; walk++) {
        const [slot, start] = [walk % 144, Date.UTC(2025, 0, 6) / 1000 + walk * 600];
        if (slot < 42 || slot >= 114) continue;
        for (let step = 0; step < 12; step++) {
            people.push(`${start + step},people,${(slot < 72 ? step : 11 - step) + 0.5},2.5`);
            heading.push(`${start + step},heading,${slot < 72 ? 0.1 : 3.1}`);
        }
    }
    for (const map of ['hall', 'newhall']) {
        daemon.run('map', 'create', map, '--time-zone', 'UTC');
        daemon.run('state', 'add', map, 'heading', '--kind', 'angle');
        for (const [label, rows] of Object.entries({ people, heading })) {
            const file = join(folder, `${label}.csv`);
            writeFileSync(file, `${rows.join('\n')}\n`);
            daemon.run('observe', map, file, '--producer', 'camera', '--label', label);
        }
    }
    daemon.run('update', 'hall');
}
