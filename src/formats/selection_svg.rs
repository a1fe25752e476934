//! The curve of a feature elimination as a picture: score against the number of features, with its spread.

use std::fmt::Write as _;

use firn_science::forecast::selection::{FeatureSelection, SizeScore};

const WIDTH: f64 = 720.0;
const HEIGHT: f64 = 420.0;
const LEFT: f64 = 64.0;
const RIGHT: f64 = 20.0;
const TOP: f64 = 56.0;
const BOTTOM: f64 = 52.0;

/// Maps numbers of features and scores to the picture.
struct Plane {
    sizes: f64,
    low: f64,
    high: f64,
}

impl Plane {
    fn of(curve: &[SizeScore]) -> Self {
        let band = |score: &SizeScore| (score.auc, score.standard_error.unwrap_or(0.0));
        let low = curve.iter().map(band).fold(1.0, |low, (auc, error)| f64::min(low, auc - error));
        let high = curve.iter().map(band).fold(0.0, |high, (auc, error)| f64::max(high, auc + error));
        // whole twentieths, with one at least between them
        let low = ((low * 20.0).floor() / 20.0).max(0.0);
        let high = ((high * 20.0).ceil() / 20.0).clamp(low + 0.05, 1.0);
        Self { sizes: curve.len() as f64, low: low.min(high - 0.05), high }
    }

    fn x(&self, features: usize) -> f64 {
        let span = (self.sizes - 1.0).max(1.0);
        LEFT + (features as f64 - 1.0) / span * (WIDTH - LEFT - RIGHT)
    }

    fn y(&self, score: f64) -> f64 {
        TOP + (self.high - score) / (self.high - self.low) * (HEIGHT - TOP - BOTTOM)
    }

    fn points(&self, values: impl Iterator<Item = (usize, f64)>) -> String {
        values.map(|(size, score)| format!("{:.1},{:.1}", self.x(size), self.y(score))).collect::<Vec<_>>().join(" ")
    }
}

/// Draws the curve as SVG, 720 x 420 pixels, light or dark as the viewer prefers. `used` is the number of features that a
/// model was trained with, if there is one.
#[must_use]
pub fn draw(selection: &FeatureSelection, used: Option<usize>) -> String {
    let curve = &selection.curve;
    let plane = Plane::of(curve);
    let mut svg = String::new();
    head(&mut svg, selection);
    grid(&mut svg, &plane, curve.len());
    let upper = curve.iter().map(|score| (score.features, score.auc + score.standard_error.unwrap_or(0.0)));
    let lower = curve.iter().rev().map(|score| (score.features, score.auc - score.standard_error.unwrap_or(0.0)));
    // writing to a String cannot fail
    let _ = writeln!(svg, r#"<polygon class="band" points="{}"/>"#, plane.points(upper.chain(lower)));
    if let Some(best) = curve.iter().find(|score| score.features == selection.best) {
        let enough = plane.y(best.auc - best.standard_error.unwrap_or(0.0));
        let _ = writeln!(
            svg,
            r#"<line class="enough" x1="{LEFT}" y1="{enough:.1}" x2="{:.1}" y2="{enough:.1}"/>"#,
            WIDTH - RIGHT
        );
    }
    let line = plane.points(curve.iter().map(|score| (score.features, score.auc)));
    let _ = writeln!(svg, r#"<polyline class="curve" points="{line}"/>"#);
    marks(&mut svg, &plane, selection, used);
    svg.push_str("</svg>\n");
    svg
}

fn head(svg: &mut String, selection: &FeatureSelection) {
    let label = match selection.label {
        firn_science::forecast::day::Label::Observed => "observed",
        firn_science::forecast::day::Label::Presumed => "presumed",
    };
    let _ = write!(
        svg,
        r#"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" height="{HEIGHT}" role="img" aria-labelledby="title">
<title id="title">Score of held-out seasons against the number of features</title>
<style>
svg {{ color: #1b2733; background: #fff; font: 12px system-ui, sans-serif }}
text {{ fill: currentColor }}
.grid {{ stroke: currentColor; opacity: .15 }}
.band {{ fill: #2f6fb3; opacity: .2 }}
.curve {{ fill: none; stroke: #2f6fb3; stroke-width: 2 }}
.enough {{ stroke: #b3541e; stroke-dasharray: 5 4 }}
.mark {{ fill: #b3541e }}
.used {{ fill: none; stroke: #b3541e; stroke-width: 2 }}
@media (prefers-color-scheme: dark) {{ svg {{ color: #dbe4ee; background: #10171f }} .curve {{ stroke: #6fb0f0 }} .band {{ fill: #6fb0f0 }} .mark {{ fill: #f0a070 }} .enough, .used {{ stroke: #f0a070 }} }}
</style>
<text x="{LEFT}" y="20" font-size="15" font-weight="600">How many features it takes</text>
<text x="{LEFT}" y="38">{} days of {} seasons, label {label}, lead {}, {} groups of seasons held out in turn</text>
"#,
        selection.days,
        selection.seasons,
        selection.lead,
        selection.groups.len()
    );
}

fn grid(svg: &mut String, plane: &Plane, sizes: usize) {
    let steps = ((plane.high - plane.low) * 20.0).round() as usize;
    // at most eight lines, on rounded scores
    let every = steps.div_ceil(8).max(1);
    for step in (0..=steps).step_by(every) {
        let score = plane.low + step as f64 / 20.0;
        let y = plane.y(score);
        let _ = writeln!(
            svg,
            r#"<line class="grid" x1="{LEFT}" y1="{y:.1}" x2="{:.1}" y2="{y:.1}"/><text x="{:.1}" y="{:.1}" text-anchor="end">{score:.2}</text>"#,
            WIDTH - RIGHT,
            LEFT - 8.0,
            y + 4.0
        );
    }
    let every = [1, 2, 5, 10, 20, 50, 100].into_iter().find(|every| sizes / every <= 14).unwrap_or(100);
    for size in (1..=sizes).filter(|size| *size == 1 || size % every == 0) {
        let x = plane.x(size);
        let _ =
            writeln!(svg, r#"<text x="{x:.1}" y="{:.1}" text-anchor="middle">{size}</text>"#, HEIGHT - BOTTOM + 18.0);
    }
    let _ = writeln!(
        svg,
        r#"<text x="{:.1}" y="{:.1}" text-anchor="middle">number of features</text>
<text transform="translate(16 {:.1}) rotate(-90)" text-anchor="middle">AUC: mean and standard error</text>"#,
        (LEFT + WIDTH - RIGHT) / 2.0,
        HEIGHT - 12.0,
        (TOP + HEIGHT - BOTTOM) / 2.0
    );
}

/// The best and the proposed number, and the one of the model.
fn marks(svg: &mut String, plane: &Plane, selection: &FeatureSelection, used: Option<usize>) {
    let place = |size: usize| {
        let score = selection.curve.iter().find(|score| score.features == size)?;
        Some((plane.x(size), plane.y(score.auc)))
    };
    if let Some((x, y)) = used.and_then(place) {
        let _ = writeln!(svg, r#"<circle class="used" cx="{x:.1}" cy="{y:.1}" r="8"/>"#);
    }
    let (best, proposed) = (selection.best, selection.proposed);
    let mut mark = |size: usize, words: String, below: f64| {
        let Some((x, y)) = place(size) else { return };
        let anchor = if x > WIDTH / 2.0 { "end" } else { "start" };
        let _ = writeln!(
            svg,
            r#"<circle class="mark" cx="{x:.1}" cy="{y:.1}" r="4"/><text x="{x:.1}" y="{:.1}" text-anchor="{anchor}">{words}</text>"#,
            y + below
        );
    };
    let ring = |size: usize| if used == Some(size) { ", in use" } else { "" };
    if best == proposed {
        mark(best, format!("best and proposed: {best}{}", ring(best)), 24.0);
        return;
    }
    mark(best, format!("best: {best}{}", ring(best)), 24.0);
    mark(proposed, format!("proposed: {proposed}{}", ring(proposed)), 40.0);
    if let Some(size) = used.filter(|size| *size != best && *size != proposed) {
        mark(size, format!("in use: {size}"), 56.0);
    }
}
