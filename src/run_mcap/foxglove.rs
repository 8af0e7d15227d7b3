//! The well-known schemas of Foxglove that a recording is drawn by, whole: viewers expect every field.

use super::protobuf::{Enum, Enumeration, messages};

/// Points of a line are joined into a strip, a loop, or by twos.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LineType;

impl Enumeration for LineType {
    const NAME: &'static str = "foxglove.LineType";
    const VALUES: &'static [&'static str] = &["LINE_STRIP", "LINE_LOOP", "LINE_LIST"];
}

/// Which entities are taken away.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DeletionType;

impl Enumeration for DeletionType {
    const NAME: &'static str = "foxglove.DeletionType";
    const VALUES: &'static [&'static str] = &["MATCHING_ID", "ALL"];
}

/// Type of a number in a point cloud.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NumericType;

impl Enumeration for NumericType {
    const NAME: &'static str = "foxglove.NumericType";
    const VALUES: &'static [&'static str] =
        &["UNKNOWN", "UINT8", "INT8", "UINT16", "INT16", "UINT32", "INT32", "FLOAT32", "FLOAT64"];
}

messages! {
    /// A moment.
    Timestamp = "google.protobuf.Timestamp" {
        /// Whole seconds.
        1 seconds: i64,
        /// What is beyond them, ns.
        2 nanos: i32,
    }
    /// A time span.
    Duration = "google.protobuf.Duration" {
        /// Whole seconds.
        1 seconds: i64,
        /// What is beyond them, ns.
        2 nanos: i32,
    }
    /// Red, green, blue and opacity, 0 to 1.
    Color = "foxglove.Color" {
        /// Red.
        1 r: f64,
        /// Green.
        2 g: f64,
        /// Blue.
        3 b: f64,
        /// Opacity.
        4 a: f64,
    }
    /// A vector.
    Vector3 = "foxglove.Vector3" {
        /// East.
        1 x: f64,
        /// North.
        2 y: f64,
        /// Up.
        3 z: f64,
    }
    /// A point.
    Point3 = "foxglove.Point3" {
        /// East.
        1 x: f64,
        /// North.
        2 y: f64,
        /// Up.
        3 z: f64,
    }
    /// A rotation.
    Quaternion = "foxglove.Quaternion" {
        /// Of its axis.
        1 x: f64,
        /// Of its axis.
        2 y: f64,
        /// Of its axis.
        3 z: f64,
        /// Cosine of half the angle.
        4 w: f64,
    }
    /// A place and a rotation.
    Pose = "foxglove.Pose" {
        /// Where.
        1 position: Option<Vector3>,
        /// How turned.
        2 orientation: Option<Quaternion>,
    }
    /// A word about an entity.
    KeyValuePair = "foxglove.KeyValuePair" {
        /// About what.
        1 key: String,
        /// What.
        2 value: String,
    }
    /// An arrow along its x axis.
    ArrowPrimitive = "foxglove.ArrowPrimitive" {
        /// Its tail.
        1 pose: Option<Pose>,
        /// m.
        2 shaft_length: f64,
        /// m.
        3 shaft_diameter: f64,
        /// m.
        4 head_length: f64,
        /// m.
        5 head_diameter: f64,
        /// Its colour.
        6 color: Option<Color>,
    }
    /// A cuboid.
    CubePrimitive = "foxglove.CubePrimitive" {
        /// Its centre.
        1 pose: Option<Pose>,
        /// m.
        2 size: Option<Vector3>,
        /// Its colour.
        3 color: Option<Color>,
    }
    /// An ellipsoid.
    SpherePrimitive = "foxglove.SpherePrimitive" {
        /// Its centre.
        1 pose: Option<Pose>,
        /// Diameters, m.
        2 size: Option<Vector3>,
        /// Its colour.
        3 color: Option<Color>,
    }
    /// A cylinder or cone.
    CylinderPrimitive = "foxglove.CylinderPrimitive" {
        /// Its centre.
        1 pose: Option<Pose>,
        /// m.
        2 size: Option<Vector3>,
        /// Of its lower end.
        3 bottom_scale: f64,
        /// Of its upper end.
        4 top_scale: f64,
        /// Its colour.
        5 color: Option<Color>,
    }
    /// Joined points.
    LinePrimitive = "foxglove.LinePrimitive" {
        /// How they are joined.
        1 r#type: Enum<LineType>,
        /// Their origin.
        2 pose: Option<Pose>,
        /// m, or pixels.
        3 thickness: f64,
        /// True if in pixels.
        4 scale_invariant: bool,
        /// The points.
        5 points: Vec<Point3>,
        /// Colour of all.
        6 color: Option<Color>,
        /// Colours one by one.
        7 colors: Vec<Color>,
        /// Points in another order.
        8 indices: Vec<u32>,
    }
    /// Triangles.
    TriangleListPrimitive = "foxglove.TriangleListPrimitive" {
        /// Their origin.
        1 pose: Option<Pose>,
        /// Their corners.
        2 points: Vec<Point3>,
        /// Colour of all.
        3 color: Option<Color>,
        /// Colours one by one.
        4 colors: Vec<Color>,
        /// Corners in another order.
        5 indices: Vec<u32>,
    }
    /// A label.
    TextPrimitive = "foxglove.TextPrimitive" {
        /// Its centre.
        1 pose: Option<Pose>,
        /// True if it faces who looks.
        2 billboard: bool,
        /// m, or pixels.
        3 font_size: f64,
        /// True if in pixels.
        4 scale_invariant: bool,
        /// Its colour.
        5 color: Option<Color>,
        /// What it says.
        6 text: String,
    }
    /// A model.
    ModelPrimitive = "foxglove.ModelPrimitive" {
        /// Its origin.
        1 pose: Option<Pose>,
        /// Of each axis.
        2 scale: Option<Vector3>,
        /// Its colour.
        3 color: Option<Color>,
        /// True if that counts.
        4 override_color: bool,
        /// Where it is.
        5 url: String,
        /// What it is.
        6 media_type: String,
        /// Itself.
        7 data: Vec<u8>,
    }
    /// An entity taken away.
    SceneEntityDeletion = "foxglove.SceneEntityDeletion" {
        /// When.
        1 timestamp: Option<Timestamp>,
        /// Whether all are.
        2 r#type: Enum<DeletionType>,
        /// Which.
        3 id: String,
    }
    /// An entity, in place of the one of this name before.
    SceneEntity = "foxglove.SceneEntity" {
        /// When.
        1 timestamp: Option<Timestamp>,
        /// Where its origin is.
        2 frame_id: String,
        /// Its name.
        3 id: String,
        /// When it goes by itself; never, if zero.
        4 lifetime: Option<Duration>,
        /// True if it moves with its frame.
        5 frame_locked: bool,
        /// What there is to say of it.
        6 metadata: Vec<KeyValuePair>,
        /// Arrows.
        7 arrows: Vec<ArrowPrimitive>,
        /// Cuboids.
        8 cubes: Vec<CubePrimitive>,
        /// Ellipsoids.
        9 spheres: Vec<SpherePrimitive>,
        /// Cylinders.
        10 cylinders: Vec<CylinderPrimitive>,
        /// Lines.
        11 lines: Vec<LinePrimitive>,
        /// Triangles.
        12 triangles: Vec<TriangleListPrimitive>,
        /// Labels.
        13 texts: Vec<TextPrimitive>,
        /// Models.
        14 models: Vec<ModelPrimitive>,
    }
    /// What a scene has from now on.
    SceneUpdate = "foxglove.SceneUpdate" {
        /// Taken away.
        1 deletions: Vec<SceneEntityDeletion>,
        /// Put in.
        2 entities: Vec<SceneEntity>,
    }
    /// Some poses at one moment.
    PosesInFrame = "foxglove.PosesInFrame" {
        /// When.
        1 timestamp: Option<Timestamp>,
        /// Where their origin is.
        2 frame_id: String,
        /// The poses.
        3 poses: Vec<Pose>,
    }
    /// What a number of a point is.
    PackedElementField = "foxglove.PackedElementField" {
        /// Its name.
        1 name: String,
        /// Where it is in a point's bytes.
        2 offset: u32,
        /// What type it has.
        3 r#type: Enum<NumericType>,
    }
    /// Points at one moment.
    PointCloud = "foxglove.PointCloud" {
        /// When.
        1 timestamp: Option<Timestamp>,
        /// Where their origin is.
        2 frame_id: String,
        /// The same, once more.
        3 pose: Option<Pose>,
        /// Bytes of a point.
        4 point_stride: u32,
        /// Its numbers.
        5 fields: Vec<PackedElementField>,
        /// The points.
        6 data: Vec<u8>,
    }
}
