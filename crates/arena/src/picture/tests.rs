use super::*;
use crate::claims::judge;
use crate::drill;

fn rates() -> Vec<Rate> {
    [(5.0, 1.5), (50.0, 1.2), (400.0, 1.4)]
        .into_iter()
        .map(|(hz, p50_ms)| Rate { hz, published: 100, received: 100, p50_ms, p99_ms: 3.0 * p50_ms })
        .collect()
}

/// Height and width of a PNG, and how many of its pixels are not white.
fn pixels(png: &[u8]) -> (u32, u32, usize) {
    let mut reader = png::Decoder::new(std::io::Cursor::new(png)).read_info().unwrap();
    let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut bytes).unwrap();
    (info.width, info.height, bytes.chunks(3).filter(|pixel| pixel.iter().any(|channel| *channel < 250)).count())
}

#[test]
fn every_picture_comes_as_svg_and_as_png_with_letters_and_lines() {
    let pictures = draw(&drill::runs(), &rates()).unwrap();
    assert_eq!(pictures.len(), Kind::ALL.len());
    for Picture { name, svg, png, .. } in &pictures {
        let (width, height, inked) = pixels(png);
        assert!(width >= 1000 && height >= 400, "{name}: {width} x {height}");
        assert!(inked > 5_000, "{name}: {inked} pixels are drawn");
        assert!(svg.contains("<text") && svg.contains("<polyline"), "{name}");
        assert!(!svg.contains("http://") || svg.matches("http://").count() == 1, "{name}: only the name of the format");
    }
}

#[test]
fn letters_are_drawn_where_the_machine_has_no_fonts() {
    let draw = |text: &str| {
        let mut canvas = Canvas::new((200, 60));
        {
            let area = canvas.backend().into_drawing_area();
            let letters = plotters::prelude::Text::new(text.to_owned(), (10, 10), frame::font(30));
            area.draw(&letters).unwrap();
        }
        pixels(&canvas.png().unwrap()).2
    };
    assert_eq!(draw(""), 0);
    assert!(draw("i") > 0 && draw("Waypoint") > 4 * draw("i"), "{} and {}", draw("i"), draw("Waypoint"));
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
    let facts = Facts { command: "ledgerd demo --arena", version: "1", link: "none", reader_refused: "a < b & \"c\"" };
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
