//! Plain text tables. Columns are as wide as their widest cell, as terminals show it.

use crate::foreign_text::shown;
use unicode_width::UnicodeWidthStr as _;

/// Alignment of a column's cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Align {
    /// Text.
    Left,
    /// Numbers.
    Right,
}

/// A table that grows row by row.
#[derive(Debug)]
pub struct Table {
    head: Vec<(String, Align)>,
    rows: Vec<Vec<String>>,
    /// Index of the first row below the rule.
    footer: Option<usize>,
}

impl Table {
    /// A table with these column heads.
    pub fn new(head: &[(&str, Align)]) -> Self {
        Self { head: head.iter().map(|&(t, a)| (t.into(), a)).collect(), rows: Vec::new(), footer: None }
    }

    /// Adds a row, with what others wrote as it is shown. Missing cells at its end stay empty.
    pub fn row(&mut self, cells: impl IntoIterator<Item = String>) {
        self.rows.push(cells.into_iter().map(|cell| shown(&cell).into_owned()).collect());
    }

    /// Draws a rule. The following rows are totals.
    pub fn footer(&mut self) {
        self.footer.get_or_insert(self.rows.len());
    }

    /// The table as text, with a newline after every row.
    pub fn render(&self) -> String {
        let width = |column: usize| {
            let cells = self.rows.iter().filter_map(|r| r.get(column)).map(|c| c.width());
            cells.chain([self.head[column].0.width()]).max().unwrap_or(0)
        };
        let widths: Vec<usize> = (0..self.head.len()).map(width).collect();
        let rule = "-".repeat(widths.iter().sum::<usize>() + 2 * widths.len().saturating_sub(1));
        let head: Vec<String> = self.head.iter().map(|(text, _)| text.clone()).collect();
        let mut text = self.line(&head, &widths) + &rule + "\n";
        for (index, row) in self.rows.iter().enumerate() {
            if self.footer == Some(index) {
                text += &rule;
                text.push('\n');
            }
            text += &self.line(row, &widths);
        }
        text
    }

    /// The table in Markdown, without a rule above the totals.
    pub fn markdown(&self) -> String {
        // A bar would start another cell.
        let line = |cells: &mut dyn Iterator<Item = String>| {
            let cells: Vec<String> = cells.map(|cell| cell.replace('|', "\\|")).collect();
            format!("| {} |\n", cells.join(" | "))
        };
        let rule = self.head.iter().map(|(_, align)| match align {
            Align::Left => "---".to_owned(),
            Align::Right => "---:".to_owned(),
        });
        let mut text = line(&mut self.head.iter().map(|(title, _)| title.clone()));
        text += &line(&mut rule.into_iter());
        for row in &self.rows {
            let cell = |column: usize| row.get(column).cloned().unwrap_or_default();
            text += &line(&mut (0..self.head.len()).map(cell));
        }
        text
    }

    fn line(&self, cells: &[String], widths: &[usize]) -> String {
        let mut line = String::new();
        for (column, (&width, (_, align))) in widths.iter().zip(&self.head).enumerate() {
            if column > 0 {
                line.push_str("  ");
            }
            let cell = cells.get(column).map_or("", String::as_str);
            // Formatting would count characters, of which some take two columns and others none.
            let blank = " ".repeat(width.saturating_sub(cell.width()));
            line += &match align {
                Align::Left => format!("{cell}{blank}"),
                Align::Right => format!("{blank}{cell}"),
            };
        }
        line.truncate(line.trim_end().len());
        line.push('\n');
        line
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_line_up_and_totals_are_set_off() {
        let mut table =
            Table::new(&[("frame", Align::Right), ("node", Align::Left), ("error", Align::Right)]);
        table.row(["0".into(), "été".into(), "+1.0 %".into()]);
        table.row(["12".into(), "node-2".into()]);
        table.footer();
        table.row(["total".into(), String::new(), "-12.0 %".into()]);
        let expected = "\
frame  node      error
----------------------
    0  été      +1.0 %
   12  node-2
----------------------
total          -12.0 %
";
        assert_eq!(table.render(), expected);
    }

    #[test]
    fn wide_characters_take_two_columns_and_accents_none() {
        let mut table = Table::new(&[("job", Align::Left), ("state", Align::Right)]);
        table.row(["厨房".into(), "done".into()]);
        table.row(["e\u{301}te\u{301}".into(), "failed".into()]);
        table.row(["hall".into(), "booked".into()]);
        let lines: Vec<String> = table.render().lines().map(str::to_owned).collect();
        let widths: Vec<usize> = lines.iter().map(|line| line.width()).collect();
        assert!(widths.iter().all(|&width| width == 12), "{lines:?}");
    }

    #[test]
    fn in_markdown_every_row_has_all_cells_and_a_bar_starts_none() {
        let mut table = Table::new(&[("name", Align::Left), ("mean |error|", Align::Right)]);
        table.row(["a|b".into()]);
        assert_eq!(table.markdown(), "| name | mean \\|error\\| |\n| --- | ---: |\n| a\\|b |  |\n");
    }
}
