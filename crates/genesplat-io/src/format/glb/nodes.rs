//! Where the nodes of a `.glb` put its meshes.

use super::schema::{Document, Node};

/// Refuses nodes that move one of the `meshes` (numbers, in order), or show it twice: turning harmonics in
/// general is no change of signs, and a splat is read once. Meshes without a node are where they are.
pub(super) fn check_in_place(document: &Document, meshes: &[usize]) -> Result<(), String> {
    let movers = movers(&document.nodes)?;
    let mut node_of: Vec<Option<usize>> = vec![None; meshes.len()];
    for (at, node) in document.nodes.iter().enumerate() {
        // A mesh that holds no splat may be anywhere.
        let Some(splat) = node.mesh.and_then(|mesh| meshes.binary_search(&mesh).ok()) else { continue };
        if let Some(first) = node_of[splat].replace(at) {
            return Err(format!(
                "shows its splat twice, by the nodes {first} and {at}; export it with one of them"
            ));
        }
        if let Some(mover) = movers[at] {
            return Err(format!(
                "moves its splat by node {mover}; apply the transform in the program that exported it"
            ));
        }
    }
    Ok(())
}

/// For each node the nearest that moves it: itself, or one above it. Each node is looked at once.
fn movers(nodes: &[Node]) -> Result<Vec<Option<usize>>, String> {
    let mut parents: Vec<Option<usize>> = vec![None; nodes.len()];
    for (at, node) in nodes.iter().enumerate() {
        for &child in &node.children {
            let Some(parent) = parents.get_mut(child) else { continue };
            if parent.replace(at).is_some() {
                return Err(format!(
                    "has its node {child} below two others, and glTF allows one; export it again"
                ));
            }
        }
    }
    let mut movers = vec![None; nodes.len()];
    let mut waiting: Vec<usize> = (0..nodes.len()).filter(|&at| parents[at].is_none()).collect();
    let mut reached = 0;
    while let Some(at) = waiting.pop() {
        reached += 1;
        movers[at] = if moves(&nodes[at]) { Some(at) } else { parents[at].and_then(|parent| movers[parent]) };
        waiting.extend(nodes[at].children.iter().filter(|&&child| child < nodes.len()));
    }
    // With one parent each, nodes that no root leads to are in a ring, or below one.
    if reached == nodes.len() {
        Ok(movers)
    } else {
        Err("has nodes that are below themselves; export it again".into())
    }
}

fn moves(node: &Node) -> bool {
    let differs =
        |value: &Option<Vec<f64>>, identity: &[f64]| value.as_ref().is_some_and(|value| value != identity);
    let matrix: [f64; 16] = std::array::from_fn(|i| if i % 5 == 0 { 1.0 } else { 0.0 });
    differs(&node.matrix, &matrix)
        || differs(&node.translation, &[0.0; 3])
        || differs(&node.rotation, &[0.0, 0.0, 0.0, 1.0])
        || differs(&node.scale, &[1.0; 3])
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use super::*;

    /// What is said of mesh 0, of two, in a file of these nodes.
    fn check(nodes: Value) -> Result<(), String> {
        let meshes = json!([{"primitives": []}, {"primitives": []}]);
        check_in_place(&serde_json::from_value(json!({"meshes": meshes, "nodes": nodes})).unwrap(), &[0])
    }

    #[test]
    fn splats_that_stay_where_they_are_pass() {
        assert_eq!(check(json!([])), Ok(()));
        let identity = json!({"scale": [1, 1, 1], "rotation": [0, 0, 0, 1], "children": [1]});
        assert_eq!(check(json!([identity, {"mesh": 0, "children": [9]}])), Ok(()));
        let others = json!([{"mesh": 1}, {"mesh": 1, "translation": [1, 0, 0]}, {"mesh": 7}, {"mesh": 0}]);
        assert_eq!(check(others), Ok(()), "other meshes are not looked at");
    }

    #[test]
    fn splats_that_are_moved_or_shown_twice_are_refused() {
        for (nodes, words) in [
            (json!([{"rotation": [1, 0, 0, 0], "children": [1]}, {"mesh": 0}]), "by node 0"),
            (json!([{"mesh": 0}, {"children": [0]}, {"children": [1], "scale": [1, 1, 2]}]), "by node 2"),
            (json!([{"mesh": 0, "matrix": [1, 0]}]), "by node 0"),
            (json!([{"mesh": 0}, {"mesh": 0, "translation": [100, 0, 0]}]), "by the nodes 0 and 1"),
            (json!([{"mesh": 0}, {"mesh": 1}, {"mesh": 0}]), "by the nodes 0 and 2"),
        ] {
            let problem = check(nodes).unwrap_err();
            assert!(problem.contains(words), "{problem}");
        }
    }

    #[test]
    fn nodes_that_are_no_tree_are_refused() {
        for (nodes, words) in [
            (json!([{"mesh": 0, "children": [0]}]), "below themselves"),
            (
                json!([{"mesh": 0, "children": [1]}, {"children": [2]}, {"children": [0]}, {}]),
                "below themselves",
            ),
            (json!([{"children": [2]}, {"children": [2]}, {"mesh": 0}]), "node 2 below two others"),
        ] {
            let problem = check(nodes).unwrap_err();
            assert!(problem.contains(words), "{problem}");
        }
    }
}
