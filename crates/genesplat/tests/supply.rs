//! What may enter the dependency tree: licences, sources, copies and known vulnerabilities, by the rules of
//! `deny.toml` and `supply/`, from what cargo itself says of the tree. It needs no tool but cargo, and no
//! network where the crates are there already.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;

use serde::Deserialize;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

#[derive(Deserialize)]
struct Tree {
    packages: Vec<Package>,
}

#[derive(Clone, Debug, Default, Deserialize)]
struct Package {
    name: String,
    version: String,
    license: Option<String>,
    /// `None` for the crates of this workspace.
    source: Option<String>,
    dependencies: Vec<Dependency>,
}

#[derive(Clone, Debug, Deserialize)]
struct Dependency {
    name: String,
    req: String,
    path: Option<PathBuf>,
}

fn tree() -> Tree {
    let arguments = ["metadata", "--locked", "--format-version", "1"];
    let output = Command::new(env!("CARGO")).args(arguments).current_dir(root()).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

fn file<T: serde::de::DeserializeOwned>(name: &str) -> T {
    toml::from_str(&std::fs::read_to_string(root().join(name)).unwrap()).unwrap()
}

#[derive(Deserialize)]
struct Rules {
    licenses: Licenses,
    bans: Bans,
}

#[derive(Deserialize)]
struct Licenses {
    allow: BTreeSet<String>,
}

#[derive(Deserialize)]
struct Bans {
    skip: Vec<Copied>,
}

#[derive(Deserialize)]
struct Copied {
    #[serde(rename = "crate")]
    name: String,
}

/// Whether `expression` (SPDX, or the older `MIT/Apache-2.0`) can be met by licences that are allowed: one of
/// the terms joined by OR, and of those joined by AND each.
fn is_allowed(expression: &str, allowed: &BTreeSet<String>) -> bool {
    let spaced = expression.replace('/', " OR ").replace('(', " ( ").replace(')', " ) ");
    let words: Vec<&str> = spaced.split_whitespace().collect();
    let mut rest = &words[..];
    let met = any_term(&mut rest, allowed);
    met && rest.is_empty()
}

fn any_term(words: &mut &[&str], allowed: &BTreeSet<String>) -> bool {
    let mut met = all_terms(words, allowed);
    while let ["OR", rest @ ..] = *words {
        *words = rest;
        met |= all_terms(words, allowed);
    }
    met
}

fn all_terms(words: &mut &[&str], allowed: &BTreeSet<String>) -> bool {
    let mut met = term(words, allowed);
    while let ["AND", rest @ ..] = *words {
        *words = rest;
        met &= term(words, allowed);
    }
    met
}

fn term(words: &mut &[&str], allowed: &BTreeSet<String>) -> bool {
    let (name, rest) = match *words {
        ["(", rest @ ..] => {
            *words = rest;
            let met = any_term(words, allowed);
            *words = words.strip_prefix(&[")"]).unwrap_or(&["unclosed"]);
            return met;
        }
        [name, "WITH", exception, rest @ ..] => (format!("{name} WITH {exception}"), rest),
        [name, rest @ ..] => ((*name).to_owned(), rest),
        [] => return false,
    };
    *words = rest;
    allowed.contains(&name)
}

/// What breaks the rules, one line each.
fn offences(packages: &[Package], rules: &Rules) -> Vec<String> {
    let mut found = Vec::new();
    for Package { name, version, license, source, dependencies } in packages {
        if !license.as_ref().is_some_and(|license| is_allowed(license, &rules.licenses.allow)) {
            found.push(format!("{name} {version}: the licence {license:?} is not allowed"));
        }
        match source.as_deref() {
            Some("registry+https://github.com/rust-lang/crates.io-index") => {}
            Some(other) => found.push(format!("{name} {version}: comes from {other}")),
            None => {
                let any = dependencies.iter().filter(|to| to.path.is_none() && to.req == "*");
                found.extend(any.map(|to| format!("{name}: takes any version of {}", to.name)));
            }
        }
    }
    found
}

fn versions(packages: &[Package]) -> BTreeMap<&str, Vec<&str>> {
    let mut versions: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    packages.iter().for_each(|package| versions.entry(&package.name).or_default().push(&package.version));
    versions
}

#[test]
fn licences_sources_and_requirements_are_those_that_deny_toml_allows() {
    let (packages, rules) = (tree().packages, file("deny.toml"));
    assert!(packages.len() > 100, "cargo lists the tree: {}", packages.len());
    assert_eq!(offences(&packages, &rules), [""; 0]);
    // Each kind of offence, planted.
    let honest = packages.iter().find(|package| package.name == "png").unwrap();
    let any = Dependency { name: "x".into(), req: "*".into(), path: None };
    for (planted, words) in [
        (Package { license: Some("GPL-3.0-only".into()), ..honest.clone() }, "GPL"),
        (Package { license: None, ..honest.clone() }, "None"),
        (Package { source: Some("git+https://example.org/png".into()), ..honest.clone() }, "example.org"),
        (Package { source: None, dependencies: vec![any], ..honest.clone() }, "any version of x"),
    ] {
        let found = offences(&[planted], &rules);
        assert!(found.len() == 1 && found[0].contains(words), "{found:?}");
    }
}

#[test]
fn crates_that_are_there_twice_are_known() {
    let (packages, rules): (_, Rules) = (tree().packages, file("deny.toml"));
    let versions = versions(&packages);
    let twice: Vec<&str> = versions.iter().filter(|(_, all)| all.len() > 1).map(|(name, _)| *name).collect();
    let known: Vec<&str> = rules.bans.skip.iter().map(|copied| copied.name.as_str()).collect();
    assert_eq!(twice, known, "deny.toml lists, in order, what the tree has in several versions");
}

#[derive(Deserialize)]
struct Advisories {
    without: Vec<String>,
    advisory: Vec<Advisory>,
}

#[derive(Deserialize)]
struct Advisory {
    id: String,
    #[serde(rename = "crate")]
    name: String,
    fixed: String,
}

/// Numbers of a version; what follows them (`+spec-1.1.0`) does not order versions.
fn numbers(version: &str) -> Vec<u64> {
    let core = version.split(['+', '-']).next().unwrap_or_default();
    core.split('.')
        .map(|number| number.parse().unwrap_or_else(|_| panic!("{version} is no version")))
        .collect()
}

fn vulnerable(versions: &BTreeMap<&str, Vec<&str>>, Advisory { id, name, fixed }: &Advisory) -> Vec<String> {
    let old = versions[name.as_str()].iter().filter(|version| numbers(version) < numbers(fixed));
    old.map(|version| format!("{id}: {name} {version} is older than {fixed}")).collect()
}

#[test]
fn no_crate_has_a_known_vulnerability() {
    let (packages, known): (_, Advisories) = (tree().packages, file("supply/advisories.toml"));
    let versions = versions(&packages);
    let gone: Vec<_> = known.without.iter().filter(|name| !versions.contains_key(name.as_str())).collect();
    assert!(gone.is_empty(), "supply/advisories.toml names crates that are not there any more: {gone:?}");
    let found: Vec<String> =
        known.advisory.iter().flat_map(|advisory| vulnerable(&versions, advisory)).collect();
    assert_eq!(found, [""; 0]);
    let planted = Advisory { id: "X".into(), name: "image".into(), fixed: "999.0.0".into() };
    assert_eq!(vulnerable(&versions, &planted).len(), 1);
    assert!(numbers("0.10.0") > numbers("0.9.21") && numbers("1.2.1+spec-1.1.0") == [1, 2, 1]);
}

#[derive(Deserialize)]
struct Reviews {
    #[serde(rename = "crate")]
    crates: Vec<Review>,
}

#[derive(Deserialize)]
struct Review {
    name: String,
    version: String,
    parses: String,
    seen: String,
}

#[test]
fn crates_that_parse_what_nobody_vouches_for_have_been_looked_at() {
    let (packages, reviews): (_, Reviews) = (tree().packages, file("supply/reviewed.toml"));
    let versions = versions(&packages);
    for Review { name, version, parses, seen } in &reviews.crates {
        assert_eq!(versions.get(name.as_str()), Some(&vec![version.as_str()]), "look at {name} again");
        assert!(!parses.is_empty() && !seen.is_empty());
    }
    for parser in
        ["image", "png", "zune-jpeg", "safetensors", "pytorch-reader", "serde_json", "toml", "postcard"]
    {
        assert!(reviews.crates.iter().any(|review| review.name == parser), "{parser}");
    }
}

#[test]
fn licence_expressions_are_understood() {
    let allowed: BTreeSet<String> =
        ["MIT", "Zlib", "Apache-2.0 WITH LLVM-exception"].map(str::to_owned).into();
    for met in [
        "MIT",
        "GPL-3.0 OR MIT",
        "GPL-3.0/MIT",
        "(MIT OR GPL-3.0) AND Zlib",
        "Apache-2.0 WITH LLVM-exception",
    ] {
        assert!(is_allowed(met, &allowed), "{met}");
    }
    for unmet in
        ["", "GPL-3.0", "MIT AND GPL-3.0", "(MIT OR Zlib) AND GPL-3.0", "Apache-2.0", "MIT Zlib", "(MIT"]
    {
        assert!(!is_allowed(unmet, &allowed), "{unmet}");
    }
}
