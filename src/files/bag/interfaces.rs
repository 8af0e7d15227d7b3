//! Standard message types: the fields of those that bags often have, and the hashes of those that this program writes.

use super::definition::{Types, short};

/// A message type that is written to bags.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Interface {
    /// `package/msg/Name`.
    pub name: &'static str,
    /// The hash of the type and of all types in it, as ROS 2 computes it (RIHS01).
    pub hash: &'static str,
}

/// A pose with its covariance.
pub const POSE_WITH_COVARIANCE: Interface = Interface {
    name: "geometry_msgs/msg/PoseWithCovarianceStamped",
    hash: "RIHS01_26432f9803e43727d3c8f668d1fdb3c630f548af631e2f4e31382371bfea3b6e",
};

/// A pose.
pub const POSE: Interface = Interface {
    name: "geometry_msgs/msg/PoseStamped",
    hash: "RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8",
};

/// A pose and a velocity with their covariances.
pub const ODOMETRY: Interface = Interface {
    name: "nav_msgs/msg/Odometry",
    hash: "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
};

/// A velocity.
pub const TWIST: Interface = Interface {
    name: "geometry_msgs/msg/TwistStamped",
    hash: "RIHS01_5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64",
};

/// A distance. Distributions before Iron lack its last field.
pub const RANGE: Interface = Interface {
    name: "sensor_msgs/msg/Range",
    hash: "RIHS01_b42b62562e93cbfe9d42b82fe5994dfa3d63d7d5c90a317981703f7388adff3a",
};

/// A direction.
pub const VECTOR: Interface = Interface {
    name: "geometry_msgs/msg/Vector3Stamped",
    hash: "RIHS01_d4829622288cbb443886e7ea94ea5671a3b1be6bab4ad04224432a65f7d7887a",
};

/// Frames in other frames.
pub const TRANSFORMS: Interface = Interface {
    name: "tf2_msgs/msg/TFMessage",
    hash: "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
};

/// The markers that RViz draws. Distributions before Humble have fewer fields.
pub const MARKERS: Interface = Interface {
    name: "visualization_msgs/msg/MarkerArray",
    hash: "RIHS01_86cb8800b6fb05b5eff1abd7a56f62a5641d3ae9a1c29e78e67e704f1d067dcf",
};

/// How parts of a system are.
pub const DIAGNOSTICS: Interface = Interface {
    name: "diagnostic_msgs/msg/DiagnosticArray",
    hash: "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
};

impl Interface {
    /// Its definition with those of all types in it, as bags hold it.
    #[must_use]
    pub fn text(self) -> String {
        // The definitions below are complete.
        let names: Vec<String> = Types::parse(self.name, definition(&short(self.name)).unwrap_or_default())
            .map(|types| types.names().map(str::to_owned).collect())
            .unwrap_or_default();
        let sections = names.iter().enumerate().map(|(index, name)| {
            let title = if index == 0 { String::new() } else { format!("{}\nMSG: {name}\n", "=".repeat(80)) };
            title + definition(name).unwrap_or_default()
        });
        sections.collect()
    }
}

/// The fields of a standard type, `package/Name`.
#[must_use]
pub fn definition(name: &str) -> Option<&'static str> {
    DEFINITIONS.iter().find(|(known, _)| *known == name).map(|(_, text)| *text)
}

const DEFINITIONS: [(&str, &str); 40] = [
    ("builtin_interfaces/Duration", "int32 sec\nuint32 nanosec\n"),
    ("builtin_interfaces/Time", "int32 sec\nuint32 nanosec\n"),
    ("diagnostic_msgs/DiagnosticArray", "std_msgs/Header header\nDiagnosticStatus[] status\n"),
    (
        "diagnostic_msgs/DiagnosticStatus",
        "byte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\nbyte level\nstring name\nstring message\nstring hardware_id\n\
         KeyValue[] values\n",
    ),
    ("diagnostic_msgs/KeyValue", "string key\nstring value\n"),
    ("geometry_msgs/Point", "float64 x\nfloat64 y\nfloat64 z\n"),
    ("geometry_msgs/PointStamped", "std_msgs/Header header\nPoint point\n"),
    ("geometry_msgs/Pose", "Point position\nQuaternion orientation\n"),
    ("geometry_msgs/PoseStamped", "std_msgs/Header header\nPose pose\n"),
    ("geometry_msgs/PoseWithCovariance", "Pose pose\nfloat64[36] covariance\n"),
    ("geometry_msgs/PoseWithCovarianceStamped", "std_msgs/Header header\nPoseWithCovariance pose\n"),
    ("geometry_msgs/Quaternion", "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n"),
    ("geometry_msgs/QuaternionStamped", "std_msgs/Header header\nQuaternion quaternion\n"),
    ("geometry_msgs/Transform", "Vector3 translation\nQuaternion rotation\n"),
    ("geometry_msgs/TransformStamped", "std_msgs/Header header\nstring child_frame_id\nTransform transform\n"),
    ("geometry_msgs/Twist", "Vector3 linear\nVector3 angular\n"),
    ("geometry_msgs/TwistStamped", "std_msgs/Header header\nTwist twist\n"),
    ("geometry_msgs/TwistWithCovariance", "Twist twist\nfloat64[36] covariance\n"),
    ("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z\n"),
    ("geometry_msgs/Vector3Stamped", "std_msgs/Header header\nVector3 vector\n"),
    (
        "nav_msgs/Odometry",
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n\
         geometry_msgs/TwistWithCovariance twist\n",
    ),
    ("sensor_msgs/CompressedImage", "std_msgs/Header header\nstring format\nuint8[] data\n"),
    (
        "sensor_msgs/Range",
        "std_msgs/Header header\nuint8 ULTRASOUND=0\nuint8 INFRARED=1\nuint8 radiation_type\nfloat32 field_of_view\n\
         float32 min_range\nfloat32 max_range\nfloat32 range\nfloat32 variance\n",
    ),
    ("std_msgs/ColorRGBA", "float32 r\nfloat32 g\nfloat32 b\nfloat32 a\n"),
    ("std_msgs/Float32", "float32 data\n"),
    ("std_msgs/Float32MultiArray", "MultiArrayLayout layout\nfloat32[] data\n"),
    ("std_msgs/Float64", "float64 data\n"),
    ("std_msgs/Float64MultiArray", "MultiArrayLayout layout\nfloat64[] data\n"),
    ("std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id\n"),
    ("std_msgs/Int32", "int32 data\n"),
    ("std_msgs/MultiArrayDimension", "string label\nuint32 size\nuint32 stride\n"),
    ("std_msgs/MultiArrayLayout", "MultiArrayDimension[] dim\nuint32 data_offset\n"),
    ("std_msgs/String", "string data\n"),
    ("std_msgs/UInt16", "uint16 data\n"),
    ("std_msgs/UInt32", "uint32 data\n"),
    ("tf2_msgs/TFMessage", "geometry_msgs/TransformStamped[] transforms\n"),
    (
        "visualization_msgs/Marker",
        "int32 ARROW=0\nint32 CUBE=1\nint32 SPHERE=2\nint32 CYLINDER=3\nint32 LINE_STRIP=4\nint32 LINE_LIST=5\nint32 CUBE_LIST=6\n\
         int32 SPHERE_LIST=7\nint32 POINTS=8\nint32 TEXT_VIEW_FACING=9\nint32 MESH_RESOURCE=10\nint32 TRIANGLE_LIST=11\n\
         int32 ARROW_STRIP=12\nint32 ADD=0\nint32 MODIFY=0\nint32 DELETE=2\nint32 DELETEALL=3\nstd_msgs/Header header\nstring ns\n\
         int32 id\nint32 type\nint32 action\ngeometry_msgs/Pose pose\ngeometry_msgs/Vector3 scale\nstd_msgs/ColorRGBA color\n\
         builtin_interfaces/Duration lifetime\nbool frame_locked\ngeometry_msgs/Point[] points\nstd_msgs/ColorRGBA[] colors\n\
         string texture_resource\nsensor_msgs/CompressedImage texture\nUVCoordinate[] uv_coordinates\nstring text\n\
         string mesh_resource\nMeshFile mesh_file\nbool mesh_use_embedded_materials\n",
    ),
    ("visualization_msgs/MarkerArray", "Marker[] markers\n"),
    ("visualization_msgs/MeshFile", "string filename\nuint8[] data\n"),
    ("visualization_msgs/UVCoordinate", "float32 u\nfloat32 v\n"),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn definitions_are_complete() {
        for (name, text) in DEFINITIONS {
            Types::parse(name, text).unwrap();
        }
        for interface in [POSE_WITH_COVARIANCE, POSE, ODOMETRY, TWIST, RANGE, VECTOR, TRANSFORMS, MARKERS, DIAGNOSTICS]
        {
            let text = interface.text();
            assert!(!text.is_empty() && Types::parse(interface.name, &text).is_ok(), "{text}");
            assert_eq!(text.matches("MSG: ").count() + 1, Types::parse(interface.name, &text).unwrap().names().count());
        }
    }
}
