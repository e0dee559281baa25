// Files of the shown content.

import assert from 'node:assert/strict';
import { suite, test } from 'node:test';

import { csvRow, escaped, stripsSvg } from './export';
import { stepPath, weekCsv, weekSvg } from './picture';
import type { Week } from './week';

suite('files', () => {
    test('of CSV quote what needs it', () => {
        assert.equal(csvRow(['a', 1.5, 'b,c', 'say "no"', 'two\nlines']), 'a,1.5,"b,c","say ""no""","two\nlines"\r\n');
    });

    test('of CSV have no formulas, and numbers stay numbers', () => {
        const texts = ['=HYPERLINK("http://x")', '+1+2', '-3/2', '@SUM(A1)', '\t=1', '\r=1', '＝1'];
        for (const text of texts) {
            const row = csvRow([text, 'door']);
            assert.ok(row.startsWith("'") || row.startsWith('"\''), row);
        }
        assert.equal(csvRow(['=1+1', 'a=b', '-', 'it\'s']), "'=1+1,a=b,'-,it's\r\n");
        assert.equal(csvRow([-1.5, '-1.5', '+2', '-1e-3', 1e21]), '-1.5,-1.5,+2,-1e-3,1e+21\r\n');
    });

    test('of SVG have names as text, whatever these are', () => {
        assert.equal(escaped('<a href="x">&'), '&lt;a href=&quot;x&quot;&gt;&amp;');
        const svg = stripsSvg({ title: 'home & yard', ticks: [{ share: 0.5, text: '12:00' }], rows: [{ name: '<script>', colours: ['rgb(1 2 3)', '#fff'], note: 'now' }] });
        assert.ok(svg.includes('home &amp; yard') && svg.includes('&lt;script&gt;') && !svg.includes('<script>'));
        assert.equal(svg.match(/<rect [^>]*fill="(rgb\(1 2 3\)|#fff)"/g)?.length, 3);
    });

    test('of a week have predictions with their interval, and observations', () => {
        const week: Week = {
            times: [0, 1_800_000], series: [{ name: 'door', values: [0.25, 0.5], lower: [0.1, 0.2], upper: [0.4, 0.6] }],
            seen: { times: [60_000], values: [1], note: '', pieces: undefined }, knownUntil: 60_000, observations: 1, model: undefined, isProbability: true,
        };
        assert.deepEqual(weekCsv(week, 'UTC').split('\r\n'), [
            'time,state,kind,value,lower,upper', '1970-01-01T00:00:00+00:00,door,predicted,0.25,0.1,0.4',
            '1970-01-01T00:30:00+00:00,door,predicted,0.5,0.2,0.6', '1970-01-01T00:01:00+00:00,door,observed,1,,', '',
        ]);
        const svg = weekSvg('a < b', week, 'UTC', ['#123456']);
        assert.ok(svg.includes('a &lt; b') && svg.includes('<polygon') && svg.includes('<circle'));

        const pieces = [[0, 60_000, 1], [60_000, 90_000, 0], [120_000, 130_000, 0]].map(([from = 0, to = 0, value = 0]) => ({ from, to, value, since: from }));
        const changes = { ...week, seen: { times: [60_000, 90_000], values: [0, Number.NaN], note: '', pieces } };
        assert.deepEqual(weekCsv(changes, 'UTC').split('\r\n').slice(3, 5), ['1970-01-01T00:01:00+00:00,door,reported,0,,', '1970-01-01T00:01:30+00:00,door,reported,,,']);
        assert.ok(!weekSvg('steps', changes, 'UTC', ['#123456']).includes('<circle'));
        assert.equal(stepPath(pieces, (ms) => ms / 1000, (value) => value), 'M0 1L60 1L60 0L90 0M120 0L130 0');
    });
});
