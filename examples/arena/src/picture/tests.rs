use super::*;
use crate::model::claims::judge;
use crate::model::drill;

fn rates() -> Vec<Rate> {
    [(5.0, 1.5), (50.0, 1.2), (400.0, 1.4)]
        .into_iter()
        .map(|(hz, p50_ms)| Rate { hz, published: 100, received: 100, p50_ms, p99_ms: 3.0 * p50_ms })
        .collect()
}

#[test]
fn every_picture_has_letters_and_lines_and_loads_nothing() {
    let pictures = draw(&drill::runs(), &rates()).unwrap();
    assert_eq!(pictures.len(), Kind::ALL.len());
    for Picture { name, svg, .. } in &pictures {
        assert!(svg.contains("<text") && svg.contains("<polyline"), "{name}");
        assert!(!svg.contains("http://") || svg.matches("http://").count() == 1, "{name}: only the name of the format");
    }
}

#[test]
fn the_picture_for_the_readme_is_small() {
    let pictures = draw(&drill::runs(), &rates()).unwrap();
    let overview = &pictures[0];
    assert_eq!(overview.name, "overview");
    assert!(overview.svg.len() < 150_000, "{} bytes", overview.svg.len());
}

#[test]
fn the_page_is_one_file_that_loads_nothing_and_has_everything() {
    let runs = drill::runs();
    let (figures, pictures) = (runs.figures(), draw(&runs, &rates()).unwrap());
    let facts = Facts { command: "cargo run -p arena", version: "1", link: "none", reader_refused: "a < b & \"c\"" };
    let page = page(&facts, &runs, &figures, &judge(&figures), &pictures);
    for loading in ["src=", "href=", "url(", "@import", "fetch("] {
        assert!(!page.contains(loading), "{loading}");
    }
    assert_eq!(page.matches("<svg").count(), pictures.len());
    assert!(page.contains("a &lt; b &amp; &quot;c&quot;"), "what others said is no markup");
    assert!(page.contains("A1 A2 A3 B1 B2 B3") && page.contains("const runs = [{"));
    assert!(!page.contains("BROKEN"));
    assert!(page.len() < 3_000_000, "{} bytes", page.len());
}
