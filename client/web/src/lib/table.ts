// Files of tables: the content of a view in words, as CSV, SVG and PNG.
//
// Invariant: a file has the cells of the view, in its order; numbers of a CSV file have no separators of thousands.

import { csvRow, escaped, pngOf, save, type Format } from './export';

export interface Table {
    /** The content, time and zone of the table. */
    title: string;
    head: string[];
    rows: (string | number)[][];
}

/** The cells of a table of the view. */
export function tableOf(element: HTMLTableElement, title: string): Table {
    const cells = (row: HTMLTableRowElement) => [...row.cells].map((cell) => cell.innerText.trim().replace(/\s+/g, ' '));
    const rows = [...element.tBodies].flatMap((body) => [...body.rows]).map(cells).filter((row) => row.length > 1);
    return { title, head: [...(element.tHead?.rows ?? [])].flatMap(cells), rows };
}

/** A cell without separators of thousands. */
const machineText = (cell: string | number) => (/^-?\d{1,3}(,\d{3})+(\.\d+)?$/.test(String(cell)) ? String(cell).replaceAll(',', '') : cell);

export function tableCsv({ head, rows }: Table): string {
    return [...(head.length ? [head] : []), ...rows].map((cells) => csvRow(cells.map(machineText))).join('');
}

const [LETTER, GAP, ROW, TOP, LONGEST] = [6.4, 18, 20, 52, 60];
/** More rows make a picture that no browser can draw. */
const DRAWN_MAX = 300;

export function tableSvg({ title, head, rows: all }: Table): string {
    const left = all.length - DRAWN_MAX;
    const rows = left > 0 ? [...all.slice(0, DRAWN_MAX), [`${left} more rows`]] : all;
    const cut = (cell: string | number | undefined) => (String(cell ?? '').length > LONGEST ? `${String(cell).slice(0, LONGEST - 1)}…` : String(cell ?? ''));
    const count = Math.max(head.length, ...rows.map((row) => row.length));
    const widths = Array.from({ length: count }, (_, column) => [head, ...rows].reduce((longest, row) => Math.max(longest, cut(row[column]).length), 0) * LETTER + GAP);
    const lefts = widths.map((_, column) => widths.slice(0, column).reduce((sum, width) => sum + width, 10));
    const width = Math.ceil(Math.max(title.length * 8 + 20, (lefts.at(-1) ?? 0) + (widths.at(-1) ?? 0)));
    const height = TOP + rows.length * ROW + 8;
    const line = (row: (string | number)[], y: number, style: string) => row.map((cell, column) => `<text x="${lefts[column]?.toFixed(1)}" y="${y}"${style}>${escaped(cut(cell))}</text>`).join('');
    return [
        `<svg xmlns="http://www.w3.org/2000/svg" width="${width}" height="${height}" viewBox="0 0 ${width} ${height}" font-family="sans-serif" font-size="11">`,
        `<rect width="${width}" height="${height}" fill="#fff"/><text x="10" y="18" font-size="13" font-weight="600">${escaped(title)}</text>`,
        line(head, 40, ' font-weight="600" fill="#586473"'),
        ...rows.map((row, index) => line(row, TOP + index * ROW + 8, ' fill="#17202b"')),
        '</svg>\n',
    ].join('\n');
}

/** Offers a table to be saved. */
export async function saveTable(file: string, format: Format, table: Table): Promise<void> {
    if (format === 'csv') return save(`${file}.csv`, tableCsv(table), 'text/csv');
    const svg = tableSvg(table);
    save(`${file}.${format}`, format === 'svg' ? svg : await pngOf(svg), 'image/svg+xml');
}
