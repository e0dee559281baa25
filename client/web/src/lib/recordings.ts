// Recordings of robots that are sent to the daemon: which files can be sent, under which name, and the messages of the
// daemon about them.
//
// Invariant: files are sent one after the other, and never read by the page. The daemon bounds the length of its
// messages.

/** Endings of recordings. */
const ENDINGS = ['.bag', '.mcap', '.db3', '.mcap.zstd', '.mcap.zst', '.db3.zstd', '.db3.zst'];
/** The file endings that a dialog offers. */
export const ACCEPTED = '.bag,.mcap,.db3,.zstd,.zst';
const MAP_NAME_MAX = 63;

/** Whether a text is the name of a map. */
export function isMapName(text: string): boolean {
    return /^[a-z0-9][a-z0-9_-]{0,62}$/.test(text);
}

/** A name of a map, made from the name of a file: `Office Tour_2.mcap` becomes `office-tour_2`. */
export function mapNameOf(file: string): string {
    const ending = [...ENDINGS].sort((one, other) => other.length - one.length).find((ending) => file.toLowerCase().endsWith(ending)) ?? '';
    const plain = file.slice(0, file.length - ending.length).normalize('NFKD').replace(/\p{M}/gu, '').toLowerCase();
    const name = plain.replace(/[^a-z0-9_]+/g, '-').replace(/^[-_]+/, '').slice(0, MAP_NAME_MAX).replace(/[-_]+$/, '');
    return name || 'recording';
}

/** The problem with dropped items; empty if they are recordings. */
export function complaint(dropped: readonly { name: string; isFolder: boolean }[]): string {
    if (dropped.length === 0) return 'The dropped item is no file. Drop a recording: .bag, .mcap or .db3.';
    const folder = dropped.find((one) => one.isFolder);
    if (folder) return `${folder.name} is a folder. Drop the .mcap or .db3 files in it, or use: tidemap import MAP ${folder.name}`;
    const other = dropped.find((one) => !ENDINGS.some((ending) => one.name.toLowerCase().endsWith(ending)));
    if (other) return `${other.name} is no recording that tidemap reads: those end in .bag, .mcap, .mcap.zstd or .db3.`;
    return '';
}

/** The messages of the daemon about an import, one object a line. */
export interface Said {
    line?: string;
    progress?: { seconds: number };
    done?: boolean;
    exit?: number;
    error?: { message: string };
}

/** Takes a text apart that grows: each whole line is an object. */
export class LineReader {
    private taken = 0;

    /** The objects of the lines that are whole since the last call. */
    next(text: string): Said[] {
        const end = text.lastIndexOf('\n') + 1;
        if (end <= this.taken) return [];
        const lines = text.slice(this.taken, end).split('\n').filter(Boolean);
        this.taken = end;
        return lines.map((line) => JSON.parse(line) as Said);
    }
}

/** A refusal of the daemon. */
export class Refused extends Error {
    constructor(readonly status: number, message: string) {
        super(message);
    }
}

function refusal(status: number, text: string): Refused {
    try {
        return new Refused(status, (JSON.parse(text) as Said).error?.message ?? text);
    } catch {
        return new Refused(status, `The daemon responds with status ${status}.`);
    }
}

/** The URL for a file. The name is written as the daemon wants names: composed, as not every system keeps it. */
export function pathFor(map: string, file: string, parameters: Record<string, string>): string {
    const query = new URLSearchParams(parameters).toString().replaceAll('+', '%20');
    return `/api/v1/maps/${encodeURIComponent(map)}/recordings/${encodeURIComponent(file.normalize('NFC'))}?${query}`;
}

/**
 * Queries whether a file would be taken, and whether its map exists.
 *
 * Throws `Refused`, or what `fetch` throws if the daemon is away.
 */
export async function look(map: string, file: File, producer: string, headers: Record<string, string>): Promise<boolean> {
    const answer = await fetch(pathFor(map, file.name, { producer, bytes: String(file.size) }), { headers, cache: 'no-store' });
    const text = await answer.text();
    if (!answer.ok) throw refusal(answer.status, text);
    return (JSON.parse(text) as { mapExists: boolean }).mapExists;
}

/** The receiver of events of a file that is sent. */
export interface Hearer {
    /** The share that has been sent, 0 to 1. */
    sent: (share: number) => void;
    said: (what: Said) => void;
}

/**
 * Sends a file, after which the map learns it if `update` is set. The answer is the exit status of its import: 0 if all was taken.
 *
 * Throws `Refused`, an `AbortError` if the signal ends it, or a `TypeError` if the connection breaks.
 */
export function send(map: string, file: File, producer: string, update: boolean, headers: Record<string, string>, hearer: Hearer, signal: AbortSignal): Promise<number> {
    return new Promise((done, failed) => {
        // fetch does not report how much of a file is sent.
        const request = new XMLHttpRequest();
        const lines = new LineReader();
        let end: Said | undefined;
        const hear = () => {
            if (request.status !== 200) return;
            for (const said of lines.next(request.responseText)) {
                if (said.done || said.error) end = said;
                hearer.said(said);
            }
        };
        request.open('POST', pathFor(map, file.name, { producer, update: String(update) }));
        for (const [name, value] of Object.entries({ ...headers, 'content-type': 'application/octet-stream' })) request.setRequestHeader(name, value);
        request.upload.onprogress = (event) => hearer.sent(event.total ? event.loaded / event.total : 0);
        request.upload.onload = () => hearer.sent(1);
        request.onprogress = hear;
        request.onload = () => {
            hear();
            if (request.status !== 200) failed(refusal(request.status, request.responseText));
            else if (end?.error) failed(new Refused(200, end.error.message));
            else if (end) done(end.exit ?? 1);
            else failed(new TypeError('the response broke off'));
        };
        request.onerror = () => failed(new TypeError('the connection broke'));
        request.onabort = () => failed(new DOMException('stopped', 'AbortError'));
        signal.addEventListener('abort', () => request.abort());
        request.send(file);
    });
}
