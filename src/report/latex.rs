//! The comparison table for LaTeX, in the layout of the paper's Table 1 (booktabs, colortbl, pifont, graphicx).

use std::fmt::Write;

use super::run::Role;
use super::table::{ComparisonTable, LEADS_EQUALS, MARK, STAR, TableCell, TableKind, counted, heading};
use crate::score::Goal;

/// The whole `table*` environment; ours in black, the paper's value in grey below each.
pub fn table(table: &ComparisonTable, run_id: &str) -> String {
    let mut out = String::new();
    let mut line = |text: String| {
        out.push_str(&text);
        out.push('\n');
    };
    line("% needs: booktabs, colortbl, xcolor, pifont, graphicx".into());
    line("\\providecommand{\\cmark}{\\ding{51}}\\providecommand{\\xmark}{\\ding{55}}".into());
    line("\\begin{table*}\n\\centering".into());
    line(format!(
        "\\caption{{{}: mean over {}, run \\texttt{{{}}}. {} {}$\\uparrow$\\,=\\,higher is better, $\\downarrow$\\,=\\,lower is better. Breathing and target metrics \
         apply only to methods that model respiratory state or maintain an explicit mesh, respectively. Rows below the last \
         rule are bounds and not ranked.{}}}",
        table.kind.title(),
        counted(table.cases, "case"),
        escape(run_id),
        table.kind.explanation(),
        if table.kind.ranks() { "Best ranked in \\textbf{bold}, " } else { "" },
        table
            .signs()
            .map(|(sign, means)| format!(" {}\\,=\\,{}.", escape(&sign.to_string()), escape(means)))
            .chain(table.additions().map(|sentence| format!(" {}", escape(&sentence))))
            .collect::<String>()
    ));
    let label = match table.kind {
        TableKind::Navigation => "navigation",
        TableKind::Ranking => "ranking",
        TableKind::Paper => "paper",
    };
    line(format!("\\label{{tab:respire_bench_{label}}}\n\\resizebox{{\\textwidth}}{{!}}{{%"));
    let columns: String = table.groups().iter().map(|(_, count)| format!("|{}", "c".repeat(*count))).collect();
    line(format!("\\begin{{tabular}}{{@{{}}lcc{columns}@{{}}}}\n\\toprule"));
    let last = table.groups().len() - 1;
    let titles = table.groups().into_iter().enumerate().map(|(index, (group, count))| {
        let column = if index == last { "c" } else { "c|" };
        format!("& \\multicolumn{{{count}}}{{{column}}}{{\\textbf{{{}}}}} ", group.title())
    });
    line(format!("& \\multicolumn{{2}}{{c|}}{{\\textbf{{Setting}}}} {}\\\\", titles.collect::<String>()));
    let mut column = 4;
    let mut rules = "\\cmidrule(lr){2-3}".to_owned();
    for (_, count) in table.groups() {
        let _ = write!(rules, " \\cmidrule(lr){{{column}-{}}}", column + count - 1);
        column += count;
    }
    line(rules);
    line(format!(
        "\\textbf{{Method}} & CTs & Mesh {}\\\\\n\\midrule",
        table.columns.iter().map(|m| column_heading(m)).collect::<String>()
    ));
    let mut before: Option<(Role, Option<u8>)> = None;
    for row in &table.rows {
        let section = (row.method.role, row.method.ct_scans.filter(|_| row.method.role == Role::Ranked));
        if before.is_some_and(|b| b != section) {
            line("\\midrule".into());
        }
        before = Some(section);
        if row.method.id == "ours" {
            line("\\rowcolor[gray]{0.92}".into());
        }
        let mesh = match row.method.mesh {
            Some(true) => "\\cmark",
            Some(false) => "\\xmark",
            None => "--",
        };
        let cells: String = row.cells.iter().map(dressed).collect();
        // The braces end the row before: a name that begins with a bracket would be an option of its line break or rule.
        line(format!("{{}}{} & {} & {mesh} {cells}\\\\", escape(&row.method.title), escape(&row.ct_scans)));
    }
    line("\\bottomrule\n\\end{tabular}%\n}\n\\end{table*}".into());
    out
}

fn column_heading(metric: &crate::score::Metric) -> String {
    let arrow = match metric.direction {
        Goal::Higher => "$\\uparrow$",
        Goal::Lower => "$\\downarrow$",
    };
    format!("& {}{arrow} ", escape(heading(metric)))
}

fn dressed(cell: &TableCell) -> String {
    let value = escape(&cell.starred()).replace(" min", "\\,min").replace(" s", "\\,s");
    let value = if cell.best { format!("\\textbf{{{value}}}") } else { value };
    match &cell.paper {
        Some(paper) => {
            let paper = escape(paper).replace(" min", "\\,min").replace(" s", "\\,s");
            format!("& {value} {{\\scriptsize\\color{{gray}}({paper})}} ")
        }
        None => format!("& {value} "),
    }
}

fn escape(text: &str) -> String {
    let mut out = String::new();
    for c in text.chars() {
        match c {
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => {
                out.push('\\');
                out.push(c);
            }
            '\\' => out.push_str("\\textbackslash{}"),
            '^' => out.push_str("\\textasciicircum{}"),
            '~' => out.push_str("\\textasciitilde{}"),
            '–' => out.push_str("--"),
            '<' => out.push_str("{$<$}"),
            'δ' => out.push_str("$\\delta$"),
            STAR => out.push_str("$\\star$"),
            MARK => out.push_str("$\\dagger$"),
            LEADS_EQUALS => out.push_str("$\\ddagger$"),
            c => out.push(c),
        }
    }
    out
}
