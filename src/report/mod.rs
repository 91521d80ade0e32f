//! What people and machines read: CSV, Markdown, LaTeX, HTML, plots, JUnit, gate verdicts.
