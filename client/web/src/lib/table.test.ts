// Tables as files.

import assert from 'node:assert/strict';
import { suite, test } from 'node:test';

import { tableCsv, tableSvg } from './table';

suite('a table', () => {
    const table = { title: 'jobs <all>', head: ['Map', 'Observations'], rows: [['a, b', '1,234,567'], ['c', 5]] };

    test('as CSV has its head and its rows, and numbers that programs read', () => {
        assert.equal(tableCsv(table), 'Map,Observations\r\n"a, b",1234567\r\nc,5\r\n');
        assert.equal(tableCsv({ ...table, head: [] }), '"a, b",1234567\r\nc,5\r\n');
    });

    test('as SVG has its words as text, and columns that do not overlap', () => {
        const svg = tableSvg(table);
        assert.match(svg, />jobs &lt;all&gt;</);
        const left = (text: string) => Number(new RegExp(`x="([0-9.]+)"[^>]*>${text}<`).exec(svg)?.[1]);
        assert.equal(left('Map'), left('c'));
        assert.ok(left('Observations') > left('Map') + 'a, b'.length * 6);
        assert.equal(left('Observations'), left('5'));
    });

    test('of many rows as SVG says how many are left out', () => {
        const rows = Array.from({ length: 302 }, (_, index) => [`row ${index}`]);
        const svg = tableSvg({ ...table, rows });
        assert.deepEqual([svg.includes('>row 299<'), svg.includes('>row 300<'), svg.includes('>2 more rows<')], [true, false, true]);
        assert.equal(tableCsv({ ...table, rows }).split('\r\n').length, 304);
    });
});
