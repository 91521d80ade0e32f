//! The comparison tables as aligned columns, the paper's row below ours: what `all-cases` prints at the end.

use crate::report::Role;
use crate::report::table::{ComparisonTable, arrow, heading};

/// Lines of equal columns; `*` marks the best ranked method, `(..)` a bound that is not ranked.
pub fn lines(table: &ComparisonTable) -> Vec<String> {
    let mut rows = vec![head(table)];
    for row in &table.rows {
        let name = match row.method.role {
            Role::Ranked => row.method.title.clone(),
            Role::Sanity => format!("({})", row.method.title),
        };
        let mark = |best: bool| if best { "*" } else { " " };
        let values = row.cells.iter().map(|cell| format!("{}{}", cell.starred(), mark(cell.best)));
        rows.push(std::iter::once(name).chain(values).collect());
        if row.cells.iter().any(|cell| cell.paper.is_some()) {
            let paper = row.cells.iter().map(|cell| format!("{} ", cell.paper.as_deref().unwrap_or("–")));
            rows.push(std::iter::once("  in the paper".to_owned()).chain(paper).collect());
        }
    }
    let cases = if table.cases == 1 { "one case".to_owned() } else { format!("mean of {} cases", table.cases) };
    let star: String = table.signs().map(|(sign, means)| format!(", {sign} {means}")).collect();
    let best = if table.kind.ranks() { "* best ranked method, " } else { "" };
    let title = format!("{} ({cases}): {best}(..) bounds{star}", table.kind.title());
    std::iter::once(title).chain(aligned(&rows)).collect()
}

fn head(table: &ComparisonTable) -> Vec<String> {
    let columns = table.columns.iter().map(|metric| format!("{} {} ", heading(metric), arrow(metric)));
    std::iter::once("Method".to_owned()).chain(columns).collect()
}

/// The first column to the left, the others to the right.
fn aligned(rows: &[Vec<String>]) -> Vec<String> {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let width = |c: usize| rows.iter().filter_map(|row| row.get(c)).map(|v| v.chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..columns).map(width).collect();
    let place = |(c, value): (usize, &String)| match c {
        0 => format!("{value:<0$}", widths[c]),
        _ => format!("{value:>0$}", widths[c] + 1),
    };
    rows.iter().map(|row| row.iter().enumerate().map(place).collect::<String>().trim_end().to_owned()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_aligned_by_characters_not_bytes() {
        let rows = [vec!["Method".to_owned(), "δ ↑".to_owned()], vec!["a".to_owned(), "0.125".to_owned()]];
        assert_eq!(aligned(&rows), ["Method   δ ↑", "a      0.125"]);
    }
}
