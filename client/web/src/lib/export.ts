// Files of the shown content: CSV, SVG, and PNG made of the SVG.
//
// Invariant: a file states the map, the time and the zone; text in it is escaped, and no text of a table is a formula
// to a spreadsheet. Numbers stay numbers.

export type Format = 'png' | 'svg' | 'csv';

/** Offers a file to be saved. */
export function save(name: string, content: Blob | string, type = 'text/plain'): void {
    const url = URL.createObjectURL(typeof content === 'string' ? new Blob([content], { type }) : content);
    const anchor = document.createElement('a');
    [anchor.href, anchor.download] = [url, name.replace(/[^\w.-]+/g, '_')];
    anchor.click();
    setTimeout(() => URL.revokeObjectURL(url), 10_000);
}

/** The first characters of a formula, in any of the spreadsheets; the wide forms are the forms of Japanese and Chinese
 * input. */
const FORMULA = /^[=+\-@\t\r＝＋－＠]/;

/** A number as a view writes it, which is no formula. */
const NUMBER = /^[+-]?\d+(\.\d+)?(e[+-]?\d+)?$/i;

/** A text as a spreadsheet shows it: a text that would be a formula has an apostrophe before it. */
function asText(text: string): string {
    return FORMULA.test(text) && !NUMBER.test(text) ? `'${text}` : text;
}

/** A row of CSV: RFC 4180. */
export function csvRow(cells: (string | number)[]): string {
    const texts = cells.map((cell) => (typeof cell === 'number' ? String(cell) : asText(cell)));
    return texts.map((text) => (/[",\r\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text)).join(',') + '\r\n';
}

/** Text of XML. */
export function escaped(text: string): string {
    return text.replaceAll('&', '&amp;').replaceAll('<', '&lt;').replaceAll('>', '&gt;').replaceAll('"', '&quot;');
}

export interface StripsPicture {
    title: string;
    ticks: { share: number; text: string }[];
    rows: { name: string; colours: string[]; note: string }[];
}

const [NAME, STRIP, NOTE, ROW, HEAD] = [200, 720, 170, 18, 46];

/** Rows of coloured hours, as SVG. */
export function stripsSvg({ title, ticks, rows }: StripsPicture): string {
    const [width, height] = [NAME + STRIP + NOTE, HEAD + rows.length * ROW + 8];
    const parts = [
        `<svg xmlns="http://www.w3.org/2000/svg" width="${width}" height="${height}" viewBox="0 0 ${width} ${height}" font-family="sans-serif" font-size="11">`,
        `<rect width="${width}" height="${height}" fill="#fff"/><text x="8" y="17" font-size="13" font-weight="600">${escaped(title)}</text>`,
        ...ticks.map(({ share, text }) => `<text x="${(NAME + share * STRIP).toFixed(1)}" y="38" fill="#586473">${escaped(text)}</text>`),
    ];
    for (const [index, { name, colours, note }] of rows.entries()) {
        const y = HEAD + index * ROW;
        const cell = STRIP / Math.max(1, colours.length);
        const short = name.length > 32 ? `${name.slice(0, 31)}…` : name;
        parts.push(`<text x="8" y="${y + 12}">${escaped(short)}</text>`);
        for (const [hour, colour] of colours.entries()) {
            parts.push(`<rect x="${(NAME + hour * cell).toFixed(2)}" y="${y}" width="${(cell + 0.05).toFixed(2)}" height="${ROW - 2}" fill="${colour}"/>`);
        }
        parts.push(`<rect x="${NAME}" y="${y}" width="${STRIP}" height="${ROW - 2}" fill="none" stroke="#d5dae1" stroke-width="0.5"/>`);
        parts.push(`<text x="${NAME + STRIP + 8}" y="${y + 12}" fill="#17202b">${escaped(note)}</text>`);
    }
    return `${parts.join('\n')}\n</svg>\n`;
}

/** An SVG as PNG, with `ratio` pixels for one of its units. */
export async function pngOf(svg: string, ratio = 2): Promise<Blob> {
    const picture = new Image();
    picture.src = `data:image/svg+xml;charset=utf-8,${encodeURIComponent(svg)}`;
    await picture.decode();
    const canvas = document.createElement('canvas');
    [canvas.width, canvas.height] = [picture.width * ratio, picture.height * ratio];
    canvas.getContext('2d')?.drawImage(picture, 0, 0, canvas.width, canvas.height);
    return new Promise((done, failed) => canvas.toBlob((blob) => (blob ? done(blob) : failed(new Error('the picture is too large'))), 'image/png'));
}
