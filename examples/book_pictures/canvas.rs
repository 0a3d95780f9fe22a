//! [`Canvas`]: lines, discs and letters on a picture, edges smoothed by how much of a pixel is covered.
//! Pixel centres are at whole numbers, as everywhere in this project.

use garad::core::{Image, RgbImage};
use nalgebra::Vector2;

pub(crate) type Color = [u8; 3];

// Okabe & Ito 2008: told apart with any eyes.
pub(crate) const BLACK: Color = [30, 30, 30];
pub(crate) const GRAY: Color = [150, 150, 150];
pub(crate) const PALE: Color = [225, 225, 225];
pub(crate) const WHITE: Color = [255, 255, 255];
pub(crate) const BLUE: Color = [0, 114, 178];
pub(crate) const ORANGE: Color = [213, 94, 0];
pub(crate) const GREEN: Color = [0, 158, 115];
pub(crate) const YELLOW: Color = [230, 159, 0];
pub(crate) const PINK: Color = [204, 121, 167];

/// Letters are 5 x 7 points and 2 more below the line, each point a square of this side.
pub(crate) const POINT: usize = 2;
/// From one letter to the next.
pub(crate) const ADVANCE: f64 = 6.0 * POINT as f64;

pub(crate) struct Canvas {
    pub(crate) picture: RgbImage,
}

impl Canvas {
    pub(crate) fn new(width: usize, height: usize) -> Self {
        Self {
            picture: Image::new(width, height, WHITE),
        }
    }

    /// Mixes a colour into a pixel; nothing outside of the picture.
    fn put(&mut self, x: i64, y: i64, color: Color, share: f64) {
        let (Ok(x), Ok(y)) = (usize::try_from(x), usize::try_from(y)) else {
            return;
        };
        if share <= 0.0 || x >= self.picture.width() || y >= self.picture.height() {
            return;
        }
        let pixel = &mut self.picture[(x, y)];
        for (old, new) in pixel.iter_mut().zip(color) {
            let mixed = f64::from(*old) + share.min(1.0) * (f64::from(new) - f64::from(*old));
            *old = (mixed + 0.5) as u8;
        }
    }

    /// Colours what is nearer than `half` to the shape whose distance is given.
    fn fill(
        &mut self,
        [low, high]: [[f64; 2]; 2],
        half: f64,
        color: Color,
        distance: impl Fn(f64, f64) -> f64,
    ) {
        let reach = half + 1.0;
        for y in (low[1] - reach) as i64..=(high[1] + reach) as i64 {
            for x in (low[0] - reach) as i64..=(high[0] + reach) as i64 {
                self.put(x, y, color, half + 0.5 - distance(x as f64, y as f64));
            }
        }
    }

    pub(crate) fn line(&mut self, a: [f64; 2], b: [f64; 2], width: f64, color: Color) {
        if !a.iter().chain(&b).all(|v| v.abs() < 1e5) {
            return;
        }
        let low = [a[0].min(b[0]), a[1].min(b[1])];
        let high = [a[0].max(b[0]), a[1].max(b[1])];
        let along = [b[0] - a[0], b[1] - a[1]];
        let length2 = (along[0] * along[0] + along[1] * along[1]).max(1e-12);
        self.fill([low, high], 0.5 * width, color, |x, y| {
            let (dx, dy) = (x - a[0], y - a[1]);
            let s = ((dx * along[0] + dy * along[1]) / length2).clamp(0.0, 1.0);
            length(dx - s * along[0], dy - s * along[1])
        });
    }

    pub(crate) fn path(&mut self, points: &[[f64; 2]], width: f64, color: Color) {
        for pair in points.windows(2) {
            self.line(pair[0], pair[1], width, color);
        }
    }

    pub(crate) fn disc(&mut self, at: [f64; 2], radius: f64, color: Color) {
        self.fill([at, at], radius, color, |x, y| length(x - at[0], y - at[1]));
    }

    pub(crate) fn circle(&mut self, at: [f64; 2], radius: f64, width: f64, color: Color) {
        let (low, high) = (at.map(|v| v - radius), at.map(|v| v + radius));
        self.fill([low, high], 0.5 * width, color, |x, y| {
            (length(x - at[0], y - at[1]) - radius).abs()
        });
    }

    pub(crate) fn rect(
        &mut self,
        [x0, y0]: [f64; 2],
        [x1, y1]: [f64; 2],
        width: f64,
        color: Color,
    ) {
        self.path(
            &[[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]],
            width,
            color,
        );
    }

    /// A filled rectangle.
    pub(crate) fn area(&mut self, [x0, y0]: [f64; 2], [x1, y1]: [f64; 2], color: Color) {
        for y in y0 as i64..y1 as i64 {
            for x in x0 as i64..x1 as i64 {
                self.put(x, y, color, 1.0);
            }
        }
    }

    /// Text with the upper left corner of its first letter here.
    pub(crate) fn text(&mut self, [x, y]: [f64; 2], text: &str, color: Color) {
        for (i, letter) in text.chars().enumerate() {
            for (row, bits) in glyph(letter).into_iter().enumerate() {
                for column in (0..5).filter(|column| bits >> (4 - column) & 1 == 1) {
                    for (dy, dx) in (0..POINT).flat_map(|dy| (0..POINT).map(move |dx| (dy, dx))) {
                        let px = x + ADVANCE * i as f64 + (column * POINT + dx) as f64;
                        let py = y + (row * POINT + dy) as f64;
                        self.put(px as i64, py as i64, color, 1.0);
                    }
                }
            }
        }
    }

    /// Text whose middle is at x.
    pub(crate) fn centered(&mut self, [x, y]: [f64; 2], text: &str, color: Color) {
        let half = 0.5 * ADVANCE * text.chars().count() as f64;
        self.text([x - half, y], text, color);
    }

    /// A picture with its upper left pixel here, every pixel `zoom` times as large.
    pub(crate) fn paste(&mut self, picture: &RgbImage, [x0, y0]: [usize; 2], zoom: usize) {
        for y in 0..picture.height() * zoom {
            for x in 0..picture.width() * zoom {
                let color = picture[(x / zoom, y / zoom)];
                self.put((x0 + x) as i64, (y0 + y) as i64, color, 1.0);
            }
        }
    }
}

pub(crate) fn length(x: f64, y: f64) -> f64 {
    Vector2::new(x, y).norm()
}

/// White at 0, blue below, orange above; full at -1 and 1.
pub(crate) fn signed(v: f64) -> Color {
    let full = if v < 0.0 { BLUE } else { ORANGE };
    full.map(|c| (255.0 + v.abs().min(1.0) * (f64::from(c) - 255.0)) as u8)
}

/// White at 0, black at 1.
pub(crate) fn ink(v: f64) -> Color {
    [(255.0 * (1.0 - v.clamp(0.0, 1.0))) as u8; 3]
}

/// Rows of 5 points, the leftmost the highest bit: two octal digits each.
#[rustfmt::skip]
fn glyph(letter: char) -> [u8; 9] {
    match letter {
        'a' => [0, 0, 0o16, 0o01, 0o17, 0o21, 0o17, 0, 0],
        'b' => [0o20, 0o20, 0o26, 0o31, 0o21, 0o21, 0o36, 0, 0],
        'c' => [0, 0, 0o16, 0o20, 0o20, 0o21, 0o16, 0, 0],
        'd' => [0o01, 0o01, 0o15, 0o23, 0o21, 0o21, 0o17, 0, 0],
        'e' => [0, 0, 0o16, 0o21, 0o37, 0o20, 0o16, 0, 0],
        'f' => [0o06, 0o11, 0o10, 0o34, 0o10, 0o10, 0o10, 0, 0],
        'g' => [0, 0, 0o17, 0o21, 0o21, 0o21, 0o17, 0o01, 0o16],
        'h' => [0o20, 0o20, 0o26, 0o31, 0o21, 0o21, 0o21, 0, 0],
        'i' => [0o04, 0, 0o14, 0o04, 0o04, 0o04, 0o16, 0, 0],
        'j' => [0o02, 0, 0o06, 0o02, 0o02, 0o02, 0o02, 0o22, 0o14],
        'k' => [0o20, 0o20, 0o22, 0o24, 0o30, 0o24, 0o22, 0, 0],
        'l' => [0o14, 0o04, 0o04, 0o04, 0o04, 0o04, 0o16, 0, 0],
        'm' => [0, 0, 0o32, 0o25, 0o25, 0o25, 0o25, 0, 0],
        'n' => [0, 0, 0o26, 0o31, 0o21, 0o21, 0o21, 0, 0],
        'o' => [0, 0, 0o16, 0o21, 0o21, 0o21, 0o16, 0, 0],
        'p' | 'ρ' => [0, 0, 0o36, 0o21, 0o21, 0o21, 0o36, 0o20, 0o20],
        'q' => [0, 0, 0o17, 0o21, 0o21, 0o21, 0o17, 0o01, 0o01],
        'r' => [0, 0, 0o26, 0o31, 0o20, 0o20, 0o20, 0, 0],
        's' => [0, 0, 0o17, 0o20, 0o16, 0o01, 0o36, 0, 0],
        't' => [0o10, 0o10, 0o34, 0o10, 0o10, 0o11, 0o06, 0, 0],
        'u' => [0, 0, 0o21, 0o21, 0o21, 0o23, 0o15, 0, 0],
        'v' => [0, 0, 0o21, 0o21, 0o21, 0o12, 0o04, 0, 0],
        'w' => [0, 0, 0o21, 0o21, 0o25, 0o25, 0o12, 0, 0],
        'x' => [0, 0, 0o21, 0o12, 0o04, 0o12, 0o21, 0, 0],
        'y' => [0, 0, 0o21, 0o21, 0o21, 0o21, 0o17, 0o01, 0o16],
        'z' => [0, 0, 0o37, 0o02, 0o04, 0o10, 0o37, 0, 0],
        'T' => [0o37, 0o04, 0o04, 0o04, 0o04, 0o04, 0o04, 0, 0],
        'α' => [0, 0, 0o15, 0o22, 0o22, 0o22, 0o15, 0, 0],
        'λ' => [0o20, 0o10, 0o04, 0o04, 0o12, 0o21, 0o21, 0, 0],
        'σ' => [0, 0, 0o17, 0o22, 0o21, 0o21, 0o16, 0, 0],
        '0' => [0o16, 0o21, 0o23, 0o25, 0o31, 0o21, 0o16, 0, 0],
        '1' => [0o04, 0o14, 0o04, 0o04, 0o04, 0o04, 0o16, 0, 0],
        '2' => [0o16, 0o21, 0o01, 0o02, 0o04, 0o10, 0o37, 0, 0],
        '3' => [0o37, 0o02, 0o04, 0o02, 0o01, 0o21, 0o16, 0, 0],
        '4' => [0o02, 0o06, 0o12, 0o22, 0o37, 0o02, 0o02, 0, 0],
        '5' => [0o37, 0o20, 0o36, 0o01, 0o01, 0o21, 0o16, 0, 0],
        '6' => [0o06, 0o10, 0o20, 0o36, 0o21, 0o21, 0o16, 0, 0],
        '7' => [0o37, 0o01, 0o02, 0o04, 0o10, 0o10, 0o10, 0, 0],
        '8' => [0o16, 0o21, 0o21, 0o16, 0o21, 0o21, 0o16, 0, 0],
        '9' => [0o16, 0o21, 0o21, 0o17, 0o01, 0o02, 0o14, 0, 0],
        '.' => [0, 0, 0, 0, 0, 0o14, 0o14, 0, 0],
        ',' => [0, 0, 0, 0, 0, 0o14, 0o14, 0o04, 0o10],
        '-' => [0, 0, 0, 0o16, 0, 0, 0, 0, 0],
        '+' => [0, 0o04, 0o04, 0o37, 0o04, 0o04, 0, 0, 0],
        '=' => [0, 0, 0o37, 0, 0o37, 0, 0, 0, 0],
        '(' => [0o02, 0o04, 0o10, 0o10, 0o10, 0o04, 0o02, 0, 0],
        ')' => [0o10, 0o04, 0o02, 0o02, 0o02, 0o04, 0o10, 0, 0],
        '/' => [0o01, 0o01, 0o02, 0o04, 0o10, 0o20, 0o20, 0, 0],
        ':' => [0, 0, 0o14, 0o14, 0, 0o14, 0o14, 0, 0],
        '\'' => [0o04, 0o04, 0, 0, 0, 0, 0, 0, 0],
        '^' => [0o04, 0o12, 0o21, 0, 0, 0, 0, 0, 0],
        ' ' => [0; 9],
        // A letter nobody has drawn shows as a box.
        _ => [0o37, 0o21, 0o21, 0o21, 0o21, 0o21, 0o37, 0, 0],
    }
}
