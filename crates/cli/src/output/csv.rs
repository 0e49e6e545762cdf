//! Comma-separated values (RFC 4180): the elements of a list are the rows, their fields the columns.

use super::printable;
use super::tree::Tree;

/// The columns, which are told once, and again below an empty line where others follow.
#[derive(Default)]
pub(super) struct Sheet {
    columns: Vec<String>,
}

impl Sheet {
    /// The lines of one result, with a line of headings before them where that is due.
    pub(super) fn lines(&mut self, tree: Tree) -> String {
        let rows: Vec<Vec<(String, String)>> = match tree {
            Tree::List(values) => values.into_iter().map(row).collect(),
            one => vec![row(one)],
        };
        let mut columns: Vec<String> = Vec::new();
        for (name, _) in rows.iter().flatten() {
            if !columns.contains(name) {
                columns.push(name.clone());
            }
        }
        let mut lines = String::new();
        if columns.iter().any(|name| !self.columns.contains(name)) {
            lines.push_str(if self.columns.is_empty() { "" } else { "\n" });
            lines.push_str(&line(columns.iter().map(String::as_str)));
            self.columns = columns;
        }
        let cell = |row: &Vec<(String, String)>, column: &String| {
            row.iter().find(|(name, _)| name == column).map(|(_, cell)| cell.clone()).unwrap_or_default()
        };
        for row in &rows {
            let cells: Vec<String> = self.columns.iter().map(|column| cell(row, column)).collect();
            lines.push_str(&line(cells.iter().map(String::as_str)));
        }
        lines
    }
}

/// The cells of a row, each with its column.
fn row(tree: Tree) -> Vec<(String, String)> {
    let mut cells = Vec::new();
    flatten(String::new(), tree, &mut cells);
    cells
}

/// Objects within objects have columns of their own, with a dot between the names; a list is one cell.
fn flatten(name: String, tree: Tree, cells: &mut Vec<(String, String)>) {
    match tree {
        Tree::Object(fields) => {
            for (field, value) in fields {
                let name = if name.is_empty() { field } else { format!("{name}.{field}") };
                flatten(name, value, cells);
            }
        }
        other => cells.push((if name.is_empty() { "value".to_owned() } else { name }, cell(&other))),
    }
}

/// The text of a cell: texts without their quotation marks, `null` as nothing, lists of simple values with semicolons, others as JSON.
fn cell(tree: &Tree) -> String {
    match tree {
        Tree::Leaf(text) if text == "null" => String::new(),
        Tree::Leaf(text) => serde_json::from_str::<String>(text).unwrap_or_else(|_| text.clone()),
        Tree::List(values) if values.iter().all(|value| matches!(value, Tree::Leaf(_))) => {
            values.iter().map(cell).collect::<Vec<_>>().join("; ")
        }
        other => other.to_json(),
    }
}

fn line<'a>(cells: impl Iterator<Item = &'a str>) -> String {
    cells.map(quoted).collect::<Vec<_>>().join(",") + "\n"
}

/// A cell that no program takes for a formula or for more than one cell, and no terminal obeys.
fn quoted(cell: &str) -> String {
    let cell = printable(cell);
    // A negative number is none.
    let formula = cell.starts_with(['=', '+', '-', '@']) && cell.parse::<f64>().is_err();
    if formula || cell.contains([',', '"', '\n']) {
        format!("\"{}{}\"", if formula { "'" } else { "" }, cell.replace('"', "\"\""))
    } else {
        cell.into_owned()
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn lines(sheet: &mut Sheet, json: &str) -> String {
        sheet.lines(Tree::read(json).unwrap())
    }

    #[test]
    fn a_cell_is_one_cell_and_no_formula() {
        for (cell, wanted) in [
            ("Org1/Salma", "Org1/Salma"),
            ("a, \"b\"", "\"a, \"\"b\"\"\""),
            ("=HYPERLINK(1)", "\"'=HYPERLINK(1)\""),
            ("-5.5", "-5.5"),
            ("a\nb\u{1b}", "a\\nb\\u{1b}"),
        ] {
            assert_eq!(quoted(cell), wanted);
        }
    }

    #[test]
    fn rows_are_elements_and_columns_are_fields_in_their_order() {
        let json = r#"[{"b":1,"a":{"x":"t","y":null}},{"b":2,"c":[1,"z"],"d":[{"e":1}]}]"#;
        let wanted = "b,a.x,a.y,c,d\n1,t,,,\n2,,,1; z,\"[{\"\"e\"\":1}]\"\n";
        assert_eq!(lines(&mut Sheet::default(), json), wanted);
    }

    #[test]
    fn a_stream_has_one_line_of_headings_until_other_columns_come() {
        let mut sheet = Sheet::default();
        assert_eq!(lines(&mut sheet, r#"{"a":1,"b":2}"#), "a,b\n1,2\n");
        assert_eq!(lines(&mut sheet, r#"{"b":3}"#), ",3\n");
        assert_eq!(lines(&mut sheet, r#"{"c":4}"#), "\nc\n4\n");
        assert_eq!(lines(&mut sheet, "[]"), "");
        assert_eq!(lines(&mut Sheet::default(), "7"), "value\n7\n");
    }
}
