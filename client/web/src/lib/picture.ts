// A week as a file: its predictions and observations as CSV, and the chart as SVG.

import { addDays, dayName, rfc3339 } from './civil';
import { csvRow, escaped } from './export';
import type { Piece } from './seen';
import type { Week } from './week';

/** The predictions of all series and the observations, a row for each value. */
export function weekCsv(week: Week, zone: string, state = week.series[0]?.name ?? ''): string {
    const rows = [csvRow(['time', 'state', 'kind', 'value', 'lower', 'upper'])];
    for (const one of week.series) {
        for (const [index, ms] of week.times.entries()) {
            rows.push(csvRow([rfc3339(ms, zone), one.name, 'predicted', one.values[index] ?? '', one.lower[index] ?? '', one.upper[index] ?? '']));
        }
    }
    const { times, values, pieces, isLabels } = week.seen;
    for (const [index, ms] of isLabels ? [] : times.entries()) {
        // A row without a value means that no value is known from then on.
        const value = values[index] ?? Number.NaN;
        rows.push(csvRow([rfc3339(ms, zone), state, pieces ? 'reported' : 'observed', Number.isNaN(value) ? '' : value, '', '']));
    }
    return rows.join('');
}

const [WIDTH, HEIGHT, LEFT, TOP, BOTTOM] = [900, 300, 50, 34, 24];

/** Pieces of time as steps, which are joined where one follows the other. */
export function stepPath(pieces: Piece[], x: (ms: number) => string | number, y: (value: number) => string | number): string {
    return pieces.map(({ from, to, value }, index) => `${pieces[index - 1]?.to === from ? 'L' : 'M'}${x(from)} ${y(value)}L${x(to)} ${y(value)}`).join('');
}

/** The chart of a week. */
export function weekSvg(title: string, week: Week, zone: string, colours: string[]): string {
    const [start, end] = [week.times[0] ?? 0, week.times.at(-1) ?? 1];
    const { times, values, pieces } = week.seen;
    const all = [...(week.seen.isLabels ? [] : values), ...(pieces ?? []).map((piece) => piece.value), ...week.series.flatMap((one) => [...one.values, ...one.lower, ...one.upper])].filter(Number.isFinite);
    const [low, high] = week.isProbability || all.length === 0 ? [0, 1] : [all.reduce((a, b) => Math.min(a, b)), all.reduce((a, b) => Math.max(a, b))];
    const x = (ms: number) => (LEFT + ((ms - start) / (end - start)) * (WIDTH - LEFT - 12)).toFixed(1);
    const y = (value: number) => (HEIGHT - BOTTOM - ((value - low) / Math.max(1e-12, high - low)) * (HEIGHT - TOP - BOTTOM)).toFixed(1);
    const line = (values: number[]) => values.map((value, index) => `${x(week.times[index] ?? start)},${y(value)}`).join(' ');
    const parts = [
        `<svg xmlns="http://www.w3.org/2000/svg" width="${WIDTH}" height="${HEIGHT}" viewBox="0 0 ${WIDTH} ${HEIGHT}" font-family="sans-serif" font-size="11">`,
        `<rect width="${WIDTH}" height="${HEIGHT}" fill="#fff"/><text x="8" y="16" font-size="13" font-weight="600">${escaped(title)}</text>`,
    ];
    for (let day = 0; day < 7; day++) {
        const at = addDays(start, day, zone);
        parts.push(`<line x1="${x(at)}" x2="${x(at)}" y1="${TOP}" y2="${HEIGHT - BOTTOM}" stroke="#d5dae1"/><text x="${x(at)}" y="${HEIGHT - 8}" fill="#586473">${dayName(at, zone)}</text>`);
    }
    for (const share of [0, 0.25, 0.5, 0.75, 1]) {
        const value = low + share * (high - low);
        parts.push(`<line x1="${LEFT}" x2="${WIDTH - 12}" y1="${y(value)}" y2="${y(value)}" stroke="#e6e9ee"/><text x="${LEFT - 6}" y="${Number(y(value)) + 4}" text-anchor="end" fill="#586473">${Number(value.toPrecision(3))}</text>`);
    }
    for (const [index, one] of week.series.entries()) {
        const colour = colours[index % colours.length] ?? '#888';
        if (one.upper.length) {
            const back = [...one.lower.keys()].reverse().map((at) => `${x(week.times[at] ?? start)},${y(one.lower[at] ?? low)}`);
            parts.push(`<polygon points="${line(one.upper)} ${back.join(' ')}" fill="${colour}" fill-opacity="0.18"/>`);
        }
        parts.push(`<polyline points="${line(one.values)}" fill="none" stroke="${colour}" stroke-width="1.6"/>`);
        parts.push(`<text x="${WIDTH - 12}" y="${16 + 13 * index}" text-anchor="end" fill="${colour}">${escaped(one.name)}</text>`);
    }
    if (pieces) parts.push(`<path d="${stepPath(pieces, x, y)}" fill="none" stroke="#17202b" stroke-opacity="0.6"/>`);
    else for (const [index, ms] of week.seen.isLabels ? [] : times.entries()) parts.push(`<circle cx="${x(ms)}" cy="${y(values[index] ?? low)}" r="1.6" fill="#17202b" fill-opacity="0.5"/>`);
    return `${parts.join('\n')}\n</svg>\n`;
}
