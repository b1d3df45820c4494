use super::*;
use crate::world::World;

const LIMIT: LoadLimits = LoadLimits { max_bytes: 64 << 20 };

fn load_with(bytes: &[u8], limits: &LoadLimits) -> Result<Scene, SceneError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scan.ply");
    std::fs::write(&path, bytes).unwrap();
    crate::file::load(&path, None, limits)
}

fn loaded(bytes: &[u8]) -> Scene {
    load_with(bytes, &LIMIT).unwrap_or_else(|error| panic!("{}: {error}", String::from_utf8_lossy(bytes)))
}

const HEADER: &str = "element vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n";

fn ascii(body: &str) -> Vec<u8> {
    format!("ply\nformat ascii 1.0\ncomment made here\n{HEADER}{body}").into_bytes()
}

/// The same triangle in binary; `to` writes four bytes in the file's order.
fn binary(format: &str, to: impl Fn([u8; 4]) -> [u8; 4]) -> Vec<u8> {
    let mut bytes = format!("ply\nformat {format} 1.0\n{HEADER}").into_bytes();
    for x in [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0] {
        bytes.extend(to(x.to_le_bytes()));
    }
    bytes.push(3);
    for i in 0..3u32 {
        bytes.extend(to(i.to_le_bytes()));
    }
    bytes
}

const TRIANGLE: &str = "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";

fn reversed(mut bytes: [u8; 4]) -> [u8; 4] {
    bytes.reverse();
    bytes
}

#[test]
fn text_and_both_byte_orders_are_one_triangle() {
    let files = [ascii(TRIANGLE), binary("binary_little_endian", |b| b), binary("binary_big_endian", reversed)];
    for file in &files {
        let scene = loaded(file);
        assert_eq!(World::build(&scene).positions, [[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]]);
        assert_eq!(scene.objects[0].name, "scan");
        let material = &scene.materials[0];
        assert_eq!((material.metallic, material.roughness, material.double_sided), (0.0, 1.0, true));
    }
    let windows = String::from_utf8(ascii(TRIANGLE)).unwrap().replace('\n', "\r\n");
    assert_eq!(World::build(&loaded(windows.as_bytes())).positions.len(), 1);
}

#[test]
fn attributes_polygons_strips_and_unknown_elements_are_read_or_skipped() {
    let text = "ply\nformat ascii 1.0\nelement note 1\nproperty list uchar float values\nelement vertex 4\nproperty double x\nproperty double y\nproperty double z\n\
        property float nx\nproperty float ny\nproperty float nz\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nproperty float s\nproperty float t\nproperty float confidence\n\
        element face 1\nproperty uchar flags\nproperty list uint8 uint32 vertex_index\nelement tristrips 1\nproperty list int int tristrips\nend_header\n\
        2 0.5 0.5\n0 0 0 0 0 1 255 0 0 0 0 1\n1 0 0 0 0 1 255 188 0 1 0.25 1\n1 1 0 0 0 1 0 0 0 1 1 1\n0 1 0 0 0 1 0 0 0 0 1 1\n7 4 0 1 2 3\n9 0 1 2 3 -1 0 1 2 3\n";
    let scene = loaded(text.as_bytes());
    let primitive = &scene.objects[0].mesh.primitives[0];
    // A fan of two, and two strips of two each, every second triangle turned.
    assert_eq!(primitive.triangles, [[0, 1, 2], [0, 2, 3], [0, 1, 2], [1, 3, 2], [0, 1, 2], [1, 3, 2]]);
    assert_eq!(primitive.normals.as_ref().unwrap()[0], [0.0, 0.0, 1.0]);
    assert_eq!(primitive.uvs[0].as_ref().unwrap()[1], [1.0, 0.75]);
    let colors = primitive.colors.as_ref().unwrap();
    // sRGB 188/255 is linear 0.503.
    assert!(colors[0] == [1.0, 0.0, 0.0, 1.0] && (colors[1][1] - 0.503).abs() < 1e-3, "{colors:?}");
    assert_eq!(scene.materials[0].base_color, [1.0; 4], "vertices have colours, so the surface has none");
    assert!(scene.warnings[0].contains("elements other than vertex"), "{:?}", scene.warnings);
}

/// One flaw each: (file, words of the message).
fn hostile() -> Vec<(Vec<u8>, &'static str)> {
    let head = |header: &str, body: &str| format!("ply\nformat ascii 1.0\n{header}end_header\n{body}").into_bytes();
    let little = || binary("binary_little_endian", |b| b);
    let replaced = |from: &str, to: &str| String::from_utf8(ascii(TRIANGLE)).unwrap().replace(from, to).into_bytes();
    let many = |count: &str| {
        let file = little();
        let at = file.windows(8).position(|w| w == b"vertex 3").unwrap();
        [&file[..at + 7], count.as_bytes(), &file[at + 8..]].concat()
    };
    let list_count = {
        let mut file = little();
        let at = file.len() - 13;
        file[at] = 255;
        file
    };
    let wide_list = {
        let text = String::from_utf8_lossy(&little()[..little().len() - 49]).replace("list uchar int", "list uint int");
        let mut file = text.into_bytes();
        file.extend([0u8; 36]);
        file.extend(u32::MAX.to_le_bytes());
        file.extend([0u8; 12]);
        file
    };
    let mut cut = little();
    cut.truncate(cut.len() - 1);
    vec![
        (b"".to_vec(), "not a readable PLY file"),
        (b"ply".to_vec(), "not a readable PLY file"),
        (b"ply\n".to_vec(), "end_header"),
        (b"solid cube\n".to_vec(), "not a readable PLY file"),
        (b"ply\nend_header\n".to_vec(), "No format line"),
        (replaced("format ascii 1.0", "format ascii"), "not a readable PLY file"),
        (replaced("format ascii 1.0", "format utf 1.0"), "not a readable PLY file"),
        (replaced("property float x", "property quad x"), "not a readable PLY file"),
        (replaced("property float x\n", ""), "without x, y and z"),
        (head("property float x\n", ""), "not a readable PLY file"),
        (head("element vertex 3\n", ""), "3 elements without properties"),
        (head("element vertex 18446744073709551615\n", ""), "elements without properties"),
        (head("element vertex 99999999999999999999\n", ""), "not a readable PLY file"),
        (head("element vertex -1\nproperty float x\n", ""), "not a readable PLY file"),
        (many("18446744073709551615"), "the header claims 18446744073709551615"),
        (many("4000000000"), "the header claims 4000000000"),
        (many("8"), "the header claims 8"),
        (many("2"), "without faces"),
        (replaced("element vertex 3", "element vertex 4"), "not a readable PLY file"),
        (replaced("element face 1", "element face 2"), "not a readable PLY file"),
        (replaced("element vertex 3", "element vertex 1000000000000"), "the header claims 1000000000000"),
        (list_count, "not a readable PLY file"),
        (wide_list, "not a readable PLY file"),
        (cut, "not a readable PLY file"),
        (ascii("0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n"), "names vertex 3"),
        (ascii("0 0 0\n1 0 0\n0 1 0\n3 0 1 -1\n"), "names vertex -1"),
        (ascii("0 0 0\n1 0 0\n0 1 0\n18446744073709551615 0 1 2\n"), "not a readable PLY file"),
        (ascii("0 0 0\n1 0 0\n0 1 0\n2 0 1\n"), "without faces"),
        (ascii("0 0 1e99\n1 0 0\n0 1 0\n3 0 1 2\n"), "not finite"),
        (ascii("0 0 x\n1 0 0\n0 1 0\n3 0 1 2\n"), "not a readable PLY file"),
        (ascii("0 0 0\n0 0 0\n0 0 0\n3 0 1 2\n"), "zero area"),
        (head("element vertex 1\nproperty float x\nproperty float y\nproperty float z\n", "0 0 0\n"), "cloud of points"),
        (head("element vertex 1\nproperty list uchar float x\nproperty float y\nproperty float z\n", "1 0 0 0\n"), "without faces"),
        (head("element vertex 1\nproperty float a\n", "0\n"), "without x, y and z"),
        (head("element face 1\nproperty list uchar int vertex_indices\n", "3 0 1 2\n"), "no vertices"),
        (replaced("list uchar int vertex_indices", "list uchar float vertex_indices"), "vertex_indices"),
        (replaced("list uchar int vertex_indices", "int vertex_indices"), "without faces"),
        (ascii(&"7 ".repeat(1 << 16)), "not a readable PLY file"),
    ]
}

#[test]
fn hostile_files_are_refused_in_words() {
    for (bytes, words) in hostile() {
        let shown = String::from_utf8_lossy(&bytes[..bytes.len().min(400)]).into_owned();
        let error = load_with(&bytes, &LIMIT).err().unwrap_or_else(|| panic!("accepted: {shown}")).to_string();
        assert!(error.contains(words) && error.contains("scan.ply") && error.contains("help: "), "{shown}: {error}");
        assert!(error.len() < 1000 && error.lines().count() <= 3, "{shown}: {error}");
    }
}

#[test]
fn no_prefix_and_no_single_change_of_a_file_panics() {
    let mut n_read = 0;
    for file in [ascii(TRIANGLE), binary("binary_little_endian", |b| b)] {
        for end in 0..file.len() {
            n_read += usize::from(load_with(&file[..end], &LIMIT).is_ok());
        }
        for at in 0..file.len() {
            for byte in [b'9', b'-', b' ', b'\n', 0xFF] {
                let mut changed = file.clone();
                changed[at] = byte;
                n_read += usize::from(load_with(&changed, &LIMIT).is_ok());
            }
        }
    }
    assert!(n_read > 50, "some must stay readable: {n_read}");
}

#[test]
fn memory_is_counted_before_it_is_taken() {
    let body = "0 0 0\n1 0 0\n0 1 0\n".to_string() + &"3 0 1 2\n".repeat(5000);
    let file = String::from_utf8(ascii(&body)).unwrap().replace("face 1", "face 5000");
    let mut max_bytes = 1000;
    let mut refusals = 0;
    while let Err(error) = load_with(file.as_bytes(), &LoadLimits { max_bytes }) {
        let SceneError::Memory { needed, limit, .. } = error else { panic!("{error}") };
        assert!(needed > limit && limit == max_bytes);
        max_bytes = needed;
        refusals += 1;
    }
    assert!((2..40).contains(&refusals), "{refusals}");
    assert!(max_bytes < 16 << 20, "{max_bytes}");
}
