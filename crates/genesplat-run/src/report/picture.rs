//! Pictures for pages: reduced, and encoded.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use genesplat_core::Photo;
use genesplat_io::PhotoSize;
use genesplat_io::photos::{encode_jpeg, resize};

use crate::report::html::Html;

/// Of 100: no artefact that could be taken for one of the splat's, at about a bit a pixel.
const JPEG_QUALITY: u8 = 85;
/// Writes `photo` into the page, with its longer side at most `side` px.
pub fn write(page: &mut Html, photo: &Photo, side: u32, alt: &str) {
    page.attribute_of(&format!("img src=\"{}\"", data_uri(photo, side)), "alt", alt);
}

/// The same for a sheet of small pictures: on a narrow screen it is scrolled, not shrunk.
pub(crate) fn write_sheet(page: &mut Html, sheet: &Photo, side: u32, alt: &str) {
    page.attribute_of("div tabindex=\"0\" role=\"region\"", "aria-label", alt);
    write(page, sheet, side, alt);
    page.close("div");
}

/// Writes two pictures of one size into one place, with a slider that moves the border between them.
pub fn write_slider(page: &mut Html, [left, right]: [(&str, &Photo); 2], side: u32) {
    let ratio = f64::from(left.1.width) / f64::from(left.1.height);
    page.open(&format!("div class=\"slider\" style=\"--ratio:{ratio:.4}\""));
    [left, right].iter().for_each(|(name, photo)| write(page, photo, side, name));
    page.element("span", left.0).element("span", right.0);
    let label = format!("{} on the left, {} on the right: move the border", left.0, right.0);
    let moved = "this.parentNode.style.setProperty('--at',this.value+'%')";
    let input =
        format!("input type=\"range\" min=\"0\" max=\"100\" step=\"any\" value=\"50\" oninput=\"{moved}\"");
    page.attribute_of(&input, "aria-label", &label).close("div");
}

fn data_uri(photo: &Photo, side: u32) -> String {
    let (width, height) = PhotoSize::MaxSide(side).of(photo.width, photo.height);
    let jpeg = encode_jpeg(&resize(photo, width, height), JPEG_QUALITY);
    format!("data:image/jpeg;base64,{}", STANDARD.encode(jpeg))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slider_holds_both_pictures_and_names_them() {
        let photo = Photo { width: 20, height: 10, rgb: vec![90; 600] };
        let mut page = Html::new();
        write_slider(&mut page, [("photo", &photo), ("<render>", &photo)], 300);
        let text = page.into_text();
        assert_eq!(text.matches("<img src=\"data:image/jpeg;base64,").count(), 2, "{text}");
        assert!(text.contains("--ratio:2.0000") && text.contains("type=\"range\""), "{text}");
        assert!(text.contains("aria-label=\"photo on the left, &lt;render&gt; on the right"), "{text}");
    }

    #[test]
    fn pictures_are_inline_and_small() {
        let photo = Photo { width: 900, height: 600, rgb: vec![90; 3 * 900 * 600] };
        let mut page = Html::new();
        write(&mut page, &photo, 300, "a\"b");
        let text = page.into_text();
        assert!(
            text.starts_with("<img src=\"data:image/jpeg;base64,/9j/") && text.ends_with("alt=\"a&quot;b\">")
        );
        assert!(text.len() < 10_000, "{}", text.len());
    }
}
