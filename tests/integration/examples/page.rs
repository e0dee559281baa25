//! A Markdown page as the shell blocks that it has, each with the output that is shown behind it.

use std::ops::Range;

/// A block of commands.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Block {
    /// Line of the page on which its first command stands, from 1.
    pub line: usize,
    /// The commands.
    pub script: String,
    /// The output that the page states.
    pub output: Option<String>,
    /// The lines of the output, from 0.
    pub output_lines: Range<usize>,
}

/// The blocks of a page in order, or the line and the reason why the page cannot be read.
pub(crate) fn blocks(text: &str) -> Result<Vec<Block>, (usize, String)> {
    let mut blocks: Vec<Block> = Vec::new();
    // Whether an output block here would belong to the last block.
    let mut follows = false;
    let mut lines = text.lines().enumerate();
    while let Some((index, line)) = lines.next() {
        let line = line.trim_end();
        let Some(fence) = line.trim_start().strip_prefix("```") else {
            follows &= line.is_empty();
            continue;
        };
        let kind = fence.trim_start_matches('`').to_owned();
        let mut body = String::new();
        let closed = lines.by_ref().map(|(_, line)| line).find(|line| {
            let end = line.trim() == "```";
            if !end {
                body.push_str(line);
                body.push('\n');
            }
            end
        });
        if closed.is_none() {
            return Err((index + 1, "the block has no end".to_owned()));
        }
        match kind.as_str() {
            "sh" => blocks.push(Block { line: index + 2, script: body, output: None, output_lines: 0..0 }),
            "output" => match blocks.last_mut() {
                Some(block) if follows => {
                    block.output_lines = index + 1..index + 1 + body.lines().count();
                    block.output = Some(body);
                }
                _ => return Err((index + 1, "an output block must stand directly behind a sh block".to_owned())),
            },
            "" => return Err((index + 1, "the block has no kind".to_owned())),
            _ => {}
        }
        follows = kind == "sh";
    }
    Ok(blocks)
}

#[test]
fn blocks_have_lines_and_outputs() {
    let page = "# A\n\n```sh\necho a\n```\n\n```output\na\n```\ntext\n```console\nmake\n```\n```sh\necho b\n```\n";
    let block = |line, script: &str, output: Option<&str>, output_lines| Block {
        line,
        script: script.to_owned(),
        output: output.map(str::to_owned),
        output_lines,
    };
    assert_eq!(blocks(page), Ok(vec![block(4, "echo a\n", Some("a\n"), 7..8), block(15, "echo b\n", None, 0..0)]));
}

#[test]
fn unclear_pages_are_refused() {
    assert!(blocks("```sh\necho a\n").is_err_and(|(line, _)| line == 1));
    assert!(blocks("```sh\necho a\n```\nthen\n```output\na\n```\n").is_err_and(|(line, _)| line == 5));
    assert!(blocks("\n```\nwhat\n```\n").is_err_and(|(line, _)| line == 2));
}
