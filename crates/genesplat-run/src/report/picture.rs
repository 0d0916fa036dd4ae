//! Pictures for pages: reduced, and encoded.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use genesplat_core::Photo;
use genesplat_io::PhotoSize;
use genesplat_io::photos::{encode_jpeg, resize};
use maud::{Markup, html};

/// Of 100: no artefact that could be taken for one of the splat's, at about a bit a pixel.
const JPEG_QUALITY: u8 = 85;

/// `photo`, with its longer side at most `side` px.
fn picture(photo: &Photo, side: u32, alt: &str) -> Markup {
    html! { img src=(data_uri(photo, side)) alt=(alt); }
}

/// A sheet of small pictures: on a narrow screen it is scrolled, not shrunk.
pub(crate) fn sheet(sheet: &Photo, side: u32, alt: &str) -> Markup {
    html! {
        div tabindex="0" role="region" aria-label=(alt) { (picture(sheet, side, alt)) }
    }
}

/// Two pictures of one size in one place, with a slider that moves the border between them.
pub fn slider([left, right]: [(&str, &Photo); 2], side: u32) -> Markup {
    let ratio = f64::from(left.1.width) / f64::from(left.1.height);
    let moved = "this.parentNode.style.setProperty('--at',this.value+'%')";
    html! {
        div.slider style=(format!("--ratio:{ratio:.4}")) {
            @for (name, photo) in [left, right] { (picture(photo, side, name)) }
            @for (name, _) in [left, right] { span { (name) } }
            input type="range" min="0" max="100" step="any" value="50" oninput=(moved)
                aria-label={ (left.0) " on the left, " (right.0) " on the right: move the border" };
        }
    }
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
        let text = slider([("photo", &photo), ("<render>", &photo)], 300).into_string();
        assert_eq!(text.matches("<img src=\"data:image/jpeg;base64,").count(), 2, "{text}");
        assert!(text.contains("--ratio:2.0000") && text.contains("type=\"range\""), "{text}");
        assert!(text.contains("aria-label=\"photo on the left, &lt;render&gt; on the right"), "{text}");
    }

    #[test]
    fn pictures_are_inline_and_small() {
        let photo = Photo { width: 900, height: 600, rgb: vec![90; 3 * 900 * 600] };
        let text = picture(&photo, 300, "a\"b").into_string();
        assert!(
            text.starts_with("<img src=\"data:image/jpeg;base64,/9j/") && text.ends_with("alt=\"a&quot;b\">")
        );
        assert!(text.len() < 10_000, "{}", text.len());
    }
}
