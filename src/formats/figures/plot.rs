//! A plot of points and lines, drawn as SVG or PNG.

use std::sync::LazyLock;

use plotters::{
    coord::{
        Shift,
        ranged1d::{DefaultFormatting, KeyPointHint, Ranged},
    },
    element::DashedPathElement,
    prelude::*,
    style::{
        FontStyle, register_font,
        text_anchor::{HPos, Pos, VPos},
    },
};

use super::axes::{Axis, Scale};

/// Size of a picture, pixels of PNG; SVG is shown at half of it.
const SIZE: (u32, u32) = (1600, 1120);
const FONT: &str = "sans-serif";
const INK: RGBColor = RGBColor(38, 38, 38);
/// Colours that can be told apart also by the colour-blind (Okabe & Ito 2008).
const COLOURS: [RGBColor; 8] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(230, 159, 0),
    RGBColor(117, 112, 179),
    RGBColor(102, 102, 102),
];

/// How a figure is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImageFormat {
    /// Text of lines and letters.
    Svg,
    /// Pixels.
    Png,
}

impl ImageFormat {
    /// The end of its file names.
    #[must_use]
    pub const fn extension(self) -> &'static str {
        match self {
            Self::Svg => "svg",
            Self::Png => "png",
        }
    }

    /// Its media type.
    #[must_use]
    pub const fn media_type(self) -> &'static str {
        match self {
            Self::Svg => "image/svg+xml",
            Self::Png => "image/png",
        }
    }
}

/// A picture that cannot be drawn.
#[derive(Debug, thiserror::Error)]
#[error("the figure could not be drawn: {0}")]
pub struct DrawError(String);

impl DrawError {
    fn of(error: impl std::fmt::Display) -> Self {
        Self(error.to_string())
    }
}

/// A point with the ends of its error bar.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Abscissa.
    pub x: f64,
    /// Ordinate.
    pub y: f64,
    /// Error bar, from and to; none: no bar.
    pub bar: Option<(f64, f64)>,
}

impl Point {
    /// A point without error.
    #[must_use]
    pub const fn new(x: f64, y: f64) -> Self {
        Self { x, y, bar: None }
    }

    /// A point with an error to both sides.
    #[must_use]
    pub fn with_error(x: f64, y: f64, error: f64) -> Self {
        Self { x, y, bar: Some((y - error, y + error)) }
    }
}

/// How points are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mark {
    /// A dot each.
    Dots,
    /// A line through all.
    Line,
    /// A broken line through all.
    Dashes,
}

/// Points that belong together.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// What the legend says; none: it stands in no legend.
    pub label: Option<String>,
    /// How it is drawn.
    pub mark: Mark,
    /// Its colour, counted from 0.
    pub colour: usize,
    /// The points in their order.
    pub points: Vec<Point>,
}

impl Series {
    /// Some points; an empty `label` keeps them out of the legend.
    pub fn new(label: impl Into<String>, mark: Mark, colour: usize, points: Vec<Point>) -> Self {
        let label: String = label.into();
        Self { label: Some(label).filter(|label| !label.is_empty()), mark, colour, points }
    }
}

/// A corner of the plot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Corner {
    /// At the top, to the left.
    UpperLeft,
    /// At the top, to the right.
    UpperRight,
    /// At the bottom, to the left.
    LowerLeft,
    /// At the bottom, to the right.
    LowerRight,
}

/// A plot.
#[derive(Clone, Debug, PartialEq)]
pub struct Plot {
    /// What it shows.
    pub title: String,
    /// A line below the title: of what, and what was found.
    pub subtitle: String,
    /// Horizontal axis.
    pub x: Axis,
    /// Vertical axis.
    pub y: Axis,
    /// Where the legend stands, unless another corner holds less.
    pub legend: Corner,
    /// What is drawn, the first at the bottom.
    pub series: Vec<Series>,
}

type Chart<'a, DB> = ChartContext<'a, DB, Cartesian2d<Coordinate, Coordinate>>;

/// A scale as the library wants it.
struct Coordinate(Scale);

impl Ranged for Coordinate {
    type FormatOption = DefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, (from, to): (i32, i32)) -> i32 {
        let share = (value - self.0.low) / (self.0.high - self.0.low);
        from + (share * f64::from(to - from)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        if hint.weight().allow_light_points() { self.0.between.clone() } else { self.0.ticks.clone() }
    }

    fn range(&self) -> std::ops::Range<f64> {
        self.0.low..self.0.high
    }
}

impl Plot {
    /// Draws it.
    ///
    /// # Errors
    /// [`DrawError`] where the library cannot.
    pub fn draw(&self, format: ImageFormat) -> Result<Vec<u8>, DrawError> {
        static FONT_IS_THERE: LazyLock<bool> =
            LazyLock::new(|| register_font(FONT, FontStyle::Normal, dejavu::sans::regular()).is_ok());
        if !*FONT_IS_THERE {
            return Err(DrawError("the font cannot be read".into()));
        }
        match format {
            ImageFormat::Svg => {
                let mut text = String::new();
                self.draw_on(&SVGBackend::with_string(&mut text, SIZE).into_drawing_area())?;
                // shown at half of the size, so that whole pixels are half ones
                let shown = |side: u32| side / 2;
                let whole = format!("width=\"{}\" height=\"{}\"", SIZE.0, SIZE.1);
                Ok(text
                    .replacen(&whole, &format!("width=\"{}\" height=\"{}\"", shown(SIZE.0), shown(SIZE.1)), 1)
                    .into())
            }
            ImageFormat::Png => {
                let mut pixels = vec![0; (SIZE.0 * SIZE.1 * 3) as usize];
                self.draw_on(&BitMapBackend::with_buffer(&mut pixels, SIZE).into_drawing_area())?;
                png(&pixels)
            }
        }
    }

    fn draw_on<DB: DrawingBackend>(&self, area: &DrawingArea<DB, Shift>) -> Result<(), DrawError> {
        area.fill(&WHITE).map_err(DrawError::of)?;
        let text = |size: u32| (FONT, size).into_font().color(&INK).pos(Pos::new(HPos::Left, VPos::Top));
        area.draw(&Text::new(short(&self.title, 84), (40, 28), text(40))).map_err(DrawError::of)?;
        area.draw(&Text::new(short(&self.subtitle, 120), (40, 84), text(27))).map_err(DrawError::of)?;
        let (x, y) = self.scales();
        let mut chart = ChartBuilder::on(area)
            .margin(30)
            .margin_top(140)
            .x_label_area_size(96)
            .y_label_area_size(150)
            .build_cartesian_2d(Coordinate(x.clone()), Coordinate(y.clone()))
            .map_err(DrawError::of)?;
        chart
            .configure_mesh()
            .bold_line_style(INK.mix(0.16))
            .light_line_style(INK.mix(0.05))
            .axis_style(INK.stroke_width(2))
            .set_all_tick_mark_size(10)
            .x_label_formatter(&|at| x.label(*at))
            .y_label_formatter(&|at| y.label(*at))
            .x_desc(&self.x.label)
            .y_desc(&self.y.label)
            .label_style((FONT, 28).into_font().color(&INK))
            .axis_desc_style((FONT, 32).into_font().color(&INK))
            .draw()
            .map_err(DrawError::of)?;
        for series in &self.series {
            self.draw_series(&mut chart, series, &x, &y)?;
        }
        if self.series.iter().any(|series| series.label.is_some()) {
            let position = match self.freest_corner(&x, &y) {
                Corner::UpperLeft => SeriesLabelPosition::UpperLeft,
                Corner::UpperRight => SeriesLabelPosition::UpperRight,
                Corner::LowerLeft => SeriesLabelPosition::LowerLeft,
                Corner::LowerRight => SeriesLabelPosition::LowerRight,
            };
            chart
                .configure_series_labels()
                .position(position)
                .margin(24)
                .legend_area_size(56)
                .background_style(WHITE.mix(0.88))
                .border_style(INK.mix(0.25))
                .label_font((FONT, 27).into_font().color(&INK))
                .draw()
                .map_err(DrawError::of)?;
        }
        area.present().map_err(DrawError::of)
    }

    /// The corner in which the legend hides the least; the one that was asked for where that is among the best.
    fn freest_corner(&self, x: &Scale, y: &Scale) -> Corner {
        // shares of the plot that a legend takes, about
        let labels: Vec<&String> = self.series.iter().filter_map(|series| series.label.as_ref()).collect();
        let letters = labels.iter().map(|label| label.chars().count().min(60)).max().unwrap_or(0);
        let (width, height) = (0.06 + 0.0115 * letters as f64, 0.05 + 0.042 * labels.len() as f64);
        let share = |at: f64, scale: &Scale| (at - scale.low) / (scale.high - scale.low);
        let dots = self.series.iter().flat_map(|series| &series.points).flat_map(|point| {
            let (low, high) = point.bar.unwrap_or((point.y, point.y));
            [low, point.y, high].map(|y| (point.x, y))
        });
        let dots: Vec<(f64, f64)> =
            dots.filter_map(|(a, b)| Some((share(self.x.place(a)?, x), share(self.y.place(b)?, y)))).collect();
        let hidden = |corner: Corner| {
            let left = matches!(corner, Corner::UpperLeft | Corner::LowerLeft);
            let low = matches!(corner, Corner::LowerLeft | Corner::LowerRight);
            let beside = |at: f64| if left { at < width } else { at > 1.0 - width };
            let level = |at: f64| if low { at < height } else { at > 1.0 - height };
            dots.iter().filter(|(a, b)| (0.0..=1.0).contains(b) && beside(*a) && level(*b)).count()
        };
        let all = [self.legend, Corner::UpperRight, Corner::UpperLeft, Corner::LowerRight, Corner::LowerLeft];
        all.into_iter().min_by_key(|corner| hidden(*corner)).unwrap_or(self.legend)
    }

    /// The ranges of both axes: of the dots and their bars where there are any, else of all.
    fn scales(&self) -> (Scale, Scale) {
        let dots = self.series.iter().any(|series| series.mark == Mark::Dots && !series.points.is_empty());
        let of_range = self.series.iter().filter(|series| !dots || series.mark == Mark::Dots);
        let points: Vec<&Point> = of_range
            .flat_map(|series| &series.points)
            .filter(|point| self.x.place(point.x).is_some() && self.y.place(point.y).is_some())
            .collect();
        let bars = points.iter().filter_map(|point| point.bar).flat_map(|(from, to)| [from, to]);
        let y =
            self.y.scale(points.iter().map(|point| point.y).chain(bars.filter(|end| self.bar_is_short(*end, &points))));
        (self.x.scale(points.iter().map(|point| point.x)), y)
    }

    /// Whether the end of a bar may widen the axis: on a logarithmic one a bar down to nearly 0 would take all its length.
    fn bar_is_short(&self, end: f64, points: &[&Point]) -> bool {
        let least = points.iter().map(|point| point.y).fold(f64::INFINITY, f64::min);
        !self.y.log || end > 0.3 * least
    }

    fn draw_series<'a, DB: DrawingBackend + 'a>(
        &self,
        chart: &mut Chart<'a, DB>,
        series: &Series,
        x: &Scale,
        y: &Scale,
    ) -> Result<(), DrawError> {
        let colour = COLOURS[series.colour % COLOURS.len()];
        let places = series.points.iter().filter_map(|point| {
            let at = (self.x.place(point.x)?, self.y.place(point.y)?);
            (x.holds(at.0) && y.holds(at.1)).then_some((at, point))
        });
        let places: Vec<((f64, f64), &Point)> = places.collect();
        let line = places.iter().map(|(at, _)| *at);
        let stroke = colour.stroke_width(4);
        let drawn = match series.mark {
            Mark::Line => chart.draw_series(LineSeries::new(line, stroke)).map_err(DrawError::of)?,
            Mark::Dashes => chart.draw_series(DashedLineSeries::new(line, 14, 9, stroke)).map_err(DrawError::of)?,
            Mark::Dots => {
                let bars = places.iter().filter_map(|((at, _), point)| {
                    let (from, to) = point.bar?;
                    let end = |value: f64, beyond: f64| self.y.place(value).unwrap_or(beyond).clamp(y.low, y.high);
                    Some(PathElement::new([(*at, end(from, y.low)), (*at, end(to, y.high))], colour.stroke_width(2)))
                });
                chart.draw_series(bars).map_err(DrawError::of)?;
                chart.draw_series(line.map(|at| Circle::new(at, 7, colour.filled()))).map_err(DrawError::of)?
            }
        };
        if let Some(label) = &series.label {
            let mark = series.mark;
            drawn.label(short(label, 60)).legend(move |(x, y)| match mark {
                Mark::Dots => Circle::new((x + 26, y), 7, colour.filled()).into_dyn(),
                Mark::Line => PathElement::new([(x + 4, y), (x + 48, y)], stroke).into_dyn(),
                Mark::Dashes => DashedPathElement::new([(x + 4, y), (x + 48, y)], 14, 9, stroke).into_dyn(),
            });
        }
        Ok(())
    }
}

/// Three bytes a pixel, row by row, as a PNG.
fn png(pixels: &[u8]) -> Result<Vec<u8>, DrawError> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, SIZE.0, SIZE.1);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header().map_err(DrawError::of)?;
    writer.write_image_data(pixels).map_err(DrawError::of)?;
    writer.finish().map_err(DrawError::of)?;
    Ok(bytes)
}

fn short(text: &str, most: usize) -> String {
    if text.chars().count() <= most {
        return text.to_owned();
    }
    text.chars().take(most - 1).chain(['…']).collect()
}
