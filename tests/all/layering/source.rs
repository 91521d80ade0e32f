//! What the sources of a crate import and define, read with `syn`: the compiler does not forbid an import that the
//! house does. Code under `#[cfg(test)]` is left out.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use proc_macro2::{TokenStream, TokenTree};
use syn::visit::{self, Visit};
use syn::{Attribute, Item, UseTree, Visibility};

/// A path in code, segment by segment: `crate::splat::View`.
type Segments = Vec<String>;

/// One source file: a module of the crate.
#[derive(Default)]
pub struct SourceFile {
    /// `["splat", "pass", "bins"]`; a `mod.rs` is called by its folder.
    pub module: Segments,
    /// Whether it is the `mod.rs` of a folder.
    pub is_folder: bool,
    /// Absolute paths that it uses.
    pub uses: Vec<Segments>,
    /// Absolute paths that it shows to others under a name of its own.
    pub re_exports: Vec<(String, Segments)>,
    /// Types and traits that it defines.
    pub types: Vec<String>,
    /// Functions across the language border, with how many arguments each takes.
    pub border_functions: Vec<(String, usize)>,
}

/// An import of one file of the crate by another.
pub struct Import<'a> {
    pub from: &'a SourceFile,
    pub to: &'a SourceFile,
    /// As it is written, without what renames it.
    pub path: String,
    /// Whether `from` only hands it on (`pub use`).
    pub re_export: bool,
}

/// All sources of a crate.
pub struct Sources {
    pub files: Vec<SourceFile>,
    index: BTreeMap<Segments, usize>,
}

impl SourceFile {
    /// `name` is the path below `src` with slashes, without `.rs`.
    fn parse(name: &str, text: &str) -> Self {
        let mut module: Segments = name.split('/').map(String::from).collect();
        let is_folder = module.last().is_some_and(|last| last == "mod");
        if is_folder {
            module.pop();
        }
        let parsed = syn::parse_file(text).unwrap_or_else(|error| panic!("{name}: {error}"));
        let file = SourceFile { module, is_folder, ..SourceFile::default() };
        let mut reader = Reader { file, inline: Vec::new() };
        reader.visit_file(&parsed);
        reader.file
    }

    /// The room it stands in.
    pub fn room(&self) -> &str {
        &self.module[0]
    }

    /// The path below `src`.
    pub fn path(&self) -> String {
        self.module.join("/") + if self.is_folder { "/mod.rs" } else { ".rs" }
    }
}

impl Sources {
    /// Of the crate below `src`; files of tests alone (`tests.rs`, `.._tests.rs`) are left out.
    pub fn read(src: &Path) -> Self {
        let mut texts = Vec::new();
        list(src, src, &mut texts);
        Sources::new(texts.iter().map(|(name, text)| (name.as_str(), text.as_str())))
    }

    /// Of names below `src` (without `.rs`) and texts.
    pub fn new<'t>(texts: impl IntoIterator<Item = (&'t str, &'t str)>) -> Self {
        let files: Vec<SourceFile> = texts.into_iter().map(|(name, text)| SourceFile::parse(name, text)).collect();
        let index = files.iter().enumerate().map(|(i, file)| (file.module.clone(), i)).collect();
        Sources { files, index }
    }

    /// Every import of one file by another, re-exports followed to the file that defines the name.
    pub fn imports(&self) -> Vec<Import<'_>> {
        let mut all = Vec::new();
        for from in &self.files {
            let handed_on = from.re_exports.iter().map(|(_, path)| (path, true));
            for (path, re_export) in from.uses.iter().map(|path| (path, false)).chain(handed_on) {
                if let Some(to) = self.resolve(path, 0)
                    && to.module != from.module
                {
                    all.push(Import { from, to, path: path.join("::"), re_export });
                }
            }
        }
        all
    }

    /// The file that defines what an absolute path names: the longest prefix that is a module, through re-exports.
    fn resolve(&self, path: &[String], depth: usize) -> Option<&SourceFile> {
        let length = (1..=path.len()).rev().find(|&n| self.index.contains_key(&path[..n]))?;
        let file = &self.files[self.index[&path[..length]]];
        let next = path.get(length).and_then(|name| file.re_exports.iter().find(|(own, _)| own == name));
        match next {
            Some((_, target)) if depth < 8 => {
                let target: Segments = target.iter().chain(&path[length + 1..]).cloned().collect();
                self.resolve(&target, depth + 1).or(Some(file))
            }
            _ => Some(file),
        }
    }
}

fn list(root: &Path, folder: &Path, texts: &mut Vec<(String, String)>) {
    let mut entries: Vec<_> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    entries.sort();
    for path in entries {
        let name = path.strip_prefix(root).unwrap().with_extension("").to_str().unwrap().to_owned();
        if path.is_dir() {
            list(root, &path, texts);
        } else if path.extension().is_some_and(|e| e == "rs") && name.contains('/') && !name.ends_with("tests") {
            texts.push((name, fs::read_to_string(&path).unwrap()));
        }
    }
}

/// Walks one file.
struct Reader {
    file: SourceFile,
    /// Inline modules (`mod name { .. }`) around the present place.
    inline: Segments,
}

impl Reader {
    /// A path as written becomes one from the root of the crate; `None` where it leads out of the crate or into scope.
    /// A child module's name without `crate` or `self` is taken for one: a path that leads nowhere resolves to nothing.
    fn absolute(&self, path: &[String]) -> Option<Segments> {
        let mut base: Segments = self.file.module.iter().chain(&self.inline).cloned().collect();
        let mut rest = path;
        match path.first()?.as_str() {
            "crate" => return Some(path[1..].to_vec()),
            "self" => rest = &path[1..],
            "super" => {
                while rest.first().is_some_and(|first| first == "super") {
                    base.pop();
                    rest = &rest[1..];
                }
            }
            _ if path.len() < 2 => return None,
            _ => {}
        }
        base.extend_from_slice(rest);
        Some(base)
    }

    fn uses(&mut self, path: &[String]) {
        self.file.uses.extend(self.absolute(path));
    }

    fn tokens(&mut self, tokens: TokenStream) {
        let mut path: Segments = Vec::new();
        let mut colons = 0;
        for token in tokens {
            match token {
                TokenTree::Ident(word) => {
                    if colons != 2 {
                        self.uses(&std::mem::take(&mut path));
                    }
                    path.push(word.to_string());
                    colons = 0;
                }
                TokenTree::Punct(mark) if mark.as_char() == ':' => colons += 1,
                other => {
                    colons = 0;
                    self.uses(&std::mem::take(&mut path));
                    if let TokenTree::Group(group) = other {
                        self.tokens(group.stream());
                    }
                }
            }
        }
        self.uses(&path);
    }
}

fn is_test(attributes: &[Attribute]) -> bool {
    let says_test = |a: &Attribute| a.meta.require_list().is_ok_and(|list| list.tokens.to_string() == "test");
    attributes.iter().any(|a| a.path().is_ident("test") || (a.path().is_ident("cfg") && says_test(a)))
}

fn attributes(item: &Item) -> &[Attribute] {
    match item {
        Item::Const(i) => &i.attrs,
        Item::Enum(i) => &i.attrs,
        Item::Fn(i) => &i.attrs,
        Item::Impl(i) => &i.attrs,
        Item::Mod(i) => &i.attrs,
        Item::Static(i) => &i.attrs,
        Item::Struct(i) => &i.attrs,
        Item::Trait(i) => &i.attrs,
        Item::Use(i) => &i.attrs,
        _ => &[],
    }
}

/// Every path of a `use`, with the name it is known by.
fn expand(tree: &UseTree, before: &[String], out: &mut Vec<(String, Segments)>) {
    let path = |last: &syn::Ident| before.iter().cloned().chain([last.to_string()]).collect::<Segments>();
    match tree {
        UseTree::Path(p) => expand(&p.tree, &path(&p.ident), out),
        UseTree::Name(n) if n.ident == "self" => {
            out.push((before.last().cloned().unwrap_or_default(), before.to_vec()))
        }
        UseTree::Name(n) => out.push((n.ident.to_string(), path(&n.ident))),
        UseTree::Rename(r) => out.push((r.rename.to_string(), path(&r.ident))),
        UseTree::Glob(_) => out.push(("*".into(), before.to_vec())),
        UseTree::Group(g) => g.items.iter().for_each(|tree| expand(tree, before, out)),
    }
}

impl<'ast> Visit<'ast> for Reader {
    fn visit_item(&mut self, item: &'ast Item) {
        if is_test(attributes(item)) {
            return;
        }
        let name = match item {
            Item::Struct(i) => Some(&i.ident),
            Item::Enum(i) => Some(&i.ident),
            Item::Union(i) => Some(&i.ident),
            Item::Trait(i) => Some(&i.ident),
            Item::Type(i) => Some(&i.ident),
            _ => None,
        };
        self.file.types.extend(name.map(ToString::to_string));
        visit::visit_item(self, item);
    }

    fn visit_item_use(&mut self, item: &'ast syn::ItemUse) {
        let mut paths = Vec::new();
        expand(&item.tree, &[], &mut paths);
        for (name, path) in paths {
            match &item.vis {
                Visibility::Inherited => self.uses(&path),
                _ => self.file.re_exports.extend(self.absolute(&path).map(|path| (name, path))),
            }
        }
    }

    fn visit_item_mod(&mut self, item: &'ast syn::ItemMod) {
        self.inline.push(item.ident.to_string());
        visit::visit_item_mod(self, item);
        self.inline.pop();
    }

    fn visit_item_foreign_mod(&mut self, item: &'ast syn::ItemForeignMod) {
        for function in &item.items {
            if let syn::ForeignItem::Fn(f) = function {
                self.file.border_functions.push((f.sig.ident.to_string(), f.sig.inputs.len()));
            }
        }
        visit::visit_item_foreign_mod(self, item);
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        let segments: Segments = path.segments.iter().map(|s| s.ident.to_string()).collect();
        if segments.len() > 1 {
            self.uses(&segments);
        }
        visit::visit_path(self, path);
    }

    /// `pub(in crate::room)` is no import.
    fn visit_visibility(&mut self, _: &'ast Visibility) {}

    fn visit_macro(&mut self, call: &'ast syn::Macro) {
        self.tokens(call.tokens.clone());
    }

    fn visit_impl_item_fn(&mut self, function: &'ast syn::ImplItemFn) {
        if !is_test(&function.attrs) {
            visit::visit_impl_item_fn(self, function);
        }
    }
}
